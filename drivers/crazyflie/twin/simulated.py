"""Let a simulation fly the twin's body. While the wire flies it, it follows the wire."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from strands_actors.drivers.common.physics.body import Felt, Hand
from strands_actors.drivers.crazyflie.robots import AXES

from .body import Wanted
from .firmware import Firmware


class CrazyflieBody:
    axes = AXES

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self.pass_time = firmware.pass_time

    @property
    def spec(self) -> Any:
        return self._firmware.body.spec

    @property
    def hands(self) -> Sequence[Hand]:
        firmware = self._firmware
        if firmware.simulated:
            return (Hand.SIM,) * len(AXES)
        return ((Hand.WIRE if firmware.motors_on else Hand.NONE),) * len(AXES)

    def felt(self) -> Felt:
        body = self._firmware.body
        still = (0.0,) * len(AXES)
        position = (*body.velocity_m_s, body.wz_rad_s, body.xyz_m[2])
        return Felt(body.time_s, position, still, still, self.hands)

    def pose(self) -> Sequence[float]:
        pose: list[float] = self._firmware.body.data.qpos.tolist()
        return pose

    def take(self, on: bool) -> None:
        """Take or release the drone. A taken drone stays on the floor at first, motors off."""
        if Hand.WIRE not in self.hands:
            self._firmware.simulated = on
            self._firmware.fly(None)

    def aim(self, values: Sequence[float]) -> None:
        """Fly at these speeds in the world's frame. Without a climb speed, fly at the height ``z``."""
        if self._firmware.simulated:
            vx, vy, vz, wz, z = values
            self._firmware.fly(Wanted(vx, vy, vz, wz, None if vz else z))

    def hold(self) -> None:
        """Hover at the present place. On the floor, stay there."""
        if self._firmware.simulated and self._firmware.motors_on:
            self._firmware.fly(Wanted(z_m=max(0.0, self._firmware.body.xyz_m[2])))

    def land(self) -> None:
        """Land, and switch the motors off on the floor."""
        if self._firmware.simulated:
            self._firmware.descend()

    def step(self, steps: int) -> None:
        for _ in range(steps):
            self._firmware.step()

    def reset(self) -> None:
        self._firmware.reset()
