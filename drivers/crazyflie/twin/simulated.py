"""Let a local simulation (another program on this computer) fly the simulated drone. While a client
flies the drone, it obeys only the client."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from strands_actors.drivers.common.physics.body import Commander, Felt
from strands_actors.drivers.crazyflie.robots import AXES

from .body import Target
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
    def commanders(self) -> Sequence[Commander]:
        firmware = self._firmware
        if firmware.simulated:
            return (Commander.SIM,) * len(AXES)
        return ((Commander.WIRE if firmware.motors_on else Commander.NONE),) * len(AXES)

    def felt(self) -> Felt:
        body = self._firmware.body
        still = (0.0,) * len(AXES)
        position = (*body.velocity_m_s, body.wz_rad_s, body.xyz_m[2])
        return Felt(body.time_s, position, still, still, self.commanders)

    def pose(self) -> Sequence[float]:
        pose: list[float] = self._firmware.body.data.qpos.tolist()
        return pose

    def energise(self, on: bool) -> None:
        """Give the drone to the local simulation (``on``), or take it back. Both switch the motors off, so a drone
        on the floor stays there."""
        if Commander.WIRE not in self.commanders:
            self._firmware.simulated = on
            self._firmware.fly(None)

    def set_targets(self, values: Sequence[float]) -> None:
        """Fly at these speeds in the world's frame. If the climb speed is zero, fly at the height ``z``."""
        if self._firmware.simulated:
            vx, vy, vz, wz, z = values
            self._firmware.fly(Target(vx, vy, vz, wz, None if vz else z))

    def hold(self) -> None:
        """Hover at the present place. On the floor, stay there."""
        if self._firmware.simulated and self._firmware.motors_on:
            self._firmware.fly(Target(z_m=max(0.0, self._firmware.body.xyz_m[2])))

    def land(self) -> None:
        """Land, and switch the motors off on the floor."""
        if self._firmware.simulated:
            self._firmware.descend()

    def step(self, steps: int) -> None:
        for _ in range(steps):
            self._firmware.step()

    def reset(self) -> None:
        self._firmware.reset()
