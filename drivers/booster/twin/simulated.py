"""Let a simulation (another program on this computer) move the simulated robot's arms.

This is possible only while no client has the upper body. The onboard controller keeps the robot
standing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from strands_actors.drivers.booster.robots import FIRST_ARM, LAST_ARM
from strands_actors.drivers.common.physics.body import TIMESTEP_S, Commander, Felt

from .onboard import Onboard

_ARMS = slice(FIRST_ARM, LAST_ARM + 1)


class BoosterBody:
    def __init__(self, onboard: Onboard) -> None:
        self._onboard = onboard
        self.axes = tuple(joint.key for joint in onboard.model.joints)

    @property
    def spec(self) -> Any:
        return self._onboard.body.spec

    @property
    def commanders(self) -> Sequence[Commander]:
        onboard = self._onboard
        commander = (
            Commander.WIRE if onboard.host_has_arms else Commander.SIM if onboard.simulated else Commander.NONE
        )
        return (commander,) * len(self.axes)

    def pass_time(self) -> None:
        """Do nothing. The simulated onboard computer advances the body by itself."""

    def felt(self) -> Felt:
        body = self._onboard.body
        rows = (body.position_rad, body.velocity_rad_s, body.effort_nm)
        position, velocity, effort = (row[_ARMS] for row in rows)
        return Felt(float(body.data.time), position, velocity, effort, self.commanders)

    def pose(self) -> Sequence[float]:
        pose: list[float] = self._onboard.body.data.qpos.tolist()
        return pose

    def energise(self, on: bool) -> None:
        onboard = self._onboard
        if onboard.host_has_arms or on == onboard.simulated:
            return
        onboard.simulated = on
        onboard.set_arm_targets(onboard.body.position_rad[_ARMS])

    def set_targets(self, values: Sequence[float]) -> None:
        if self._onboard.simulated:
            self._onboard.set_arm_targets(values)

    def hold(self) -> None:
        self.set_targets(self._onboard.body.position_rad[_ARMS])

    def step(self, steps: int) -> None:
        for _ in range(steps):
            self._onboard.step(TIMESTEP_S)

    def reset(self) -> None:
        self._onboard.reset()
