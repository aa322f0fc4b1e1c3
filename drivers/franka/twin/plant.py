"""The simulated arm, with a stiffness that a client can choose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from strands_actors.drivers.common.physics import physics
from strands_actors.drivers.common.physics.body import Commander


class Plant(physics.Plant):
    """The simulated arm. Its servos are stiff, unless a client has chosen another stiffness for its motions."""

    _stiff: tuple[Any, Any] | None = None
    """Gains of the servos before the first change."""

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Plant:
        """Return the simulated arm of a robot's table in ``robots.toml``."""
        plant = super().from_table(table)
        assert isinstance(plant, Plant)
        return plant

    def set_stiffness(self, nm_rad: Sequence[float] | None) -> None:
        """Set the stiffness of each servo in Nm/rad, with critical damping. None: the servos are stiff again."""
        self._stiff = self._stiff or (self._kp, self._kv)
        self._kp, self._kv = self._stiff
        if nm_rad is not None:
            self._kp = np.array(nm_rad, float)
            self._kv = 2.0 * np.sqrt(self._kp * self.model.dof_M0[self._dof])
        for index in range(len(self.joints)):
            if self.commander(index) is not Commander.NONE:
                self._set_gains(index)

    def _set_gains(self, index: int) -> None:
        kp, kv = float(self._kp[index]), float(self._kv[index])
        servo = self._actuator[index]
        self.model.actuator_gainprm[servo, 0] = kp if self._state[index] < 0 else 0.0
        self.model.actuator_biasprm[servo, 1:3] = -kp, -kv
