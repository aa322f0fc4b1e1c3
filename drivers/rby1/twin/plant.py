"""The simulated joints: position servos that can be made softer, or into springs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strands_actors.drivers.common.physics.physics import Plant


class RBY1Plant(Plant):
    """The joints of an RB-Y1. A joint with torque is a stiff servo, until it is made a spring."""

    def __init__(self, *args: Any, **keywords: Any) -> None:
        super().__init__(*args, **keywords)
        self._own_kp, self._own_kv = self._kp.copy(), self._kv.copy()
        self._springs: set[int] = set()
        self._applied_nm: dict[int, float] = {}

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> RBY1Plant:
        plant = super().from_table(table)
        assert isinstance(plant, cls)
        return plant

    def set_gains(self, index: int, p_share: float, d_share: float) -> None:
        """Scale stiffness and damping of a servo: 1.0 is as built."""
        self._kp[index] = self._own_kp[index] * p_share
        self._kv[index] = self._own_kv[index] * d_share
        if index not in self._springs:
            self._pass_to(index, self._commander[index])

    def make_spring(self, index: int, nm_per_rad: float, nms_per_rad: float, most_nm: float | None = None) -> None:
        """Make a joint with torque a spring that pulls it to its target.

        Args:
            index: The joint.
            nm_per_rad: Stiffness. With 0 the joint only gets the torques of ``apply``.
            nms_per_rad: Damping.
            most_nm: The largest torque of the spring. None: the servo's own.
        """
        servo = self._actuator[index]
        self._springs.add(index)
        self.model.actuator_gainprm[servo, 0] = nm_per_rad if self._state[index] < 0 else 0.0
        self.model.actuator_biasprm[servo, 1:3] = -nm_per_rad, -nms_per_rad
        limit = self._effort_nm[index] if most_nm is None else min(most_nm, self._effort_nm[index])
        self.model.actuator_forcerange[servo] = -limit, limit

    def make_stiff(self, index: int) -> None:
        """Make a spring a servo again. It begins at the joint's position."""
        if index in self._springs:
            self._springs.discard(index)
            self.set_effort_share(index, 1.0)
            self._pass_to(index, self._commander[index])

    def is_spring(self, index: int) -> bool:
        return index in self._springs

    def weight_nm(self, index: int) -> float:
        """Return the torque that holds a joint against gravity and the motion of the others."""
        return float(self.data.qfrc_bias[self._dof[index]])

    def apply(self, nm: Mapping[int, float]) -> None:
        """Apply torques to joints, in addition to those of the servos. Joints that are not named get none."""
        if nm or self._applied_nm:
            row = [0.0] * len(self.joints)
            for index, torque in nm.items():
                limit = self._effort_nm[index]
                row[index] = min(limit, max(-limit, torque))
            self.push(row)
            self._applied_nm = dict(nm)
