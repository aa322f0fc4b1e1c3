"""Let a simulation drive the twin's body.

The simulation may have the upper body while the host does not have it. The onboard controller keeps
the robot on its legs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from strands_actors.drivers.booster.robots import FIRST_ARM, LAST_ARM
from strands_actors.drivers.common.physics.body import TIMESTEP_S, Felt, Hand

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
    def hands(self) -> Sequence[Hand]:
        onboard = self._onboard
        hand = Hand.WIRE if onboard.ours else Hand.SIM if onboard.simulated else Hand.NONE
        return (hand,) * len(self.axes)

    def pass_time(self) -> None:
        """Do nothing: the onboard computer's own ticks advance the body."""

    def felt(self) -> Felt:
        body = self._onboard.body
        rows = (body.position_rad, body.velocity_rad_s, body.effort_nm)
        position, velocity, effort = (row[_ARMS] for row in rows)
        return Felt(float(body.data.time), position, velocity, effort, self.hands)

    def pose(self) -> Sequence[float]:
        pose: list[float] = self._onboard.body.data.qpos.tolist()
        return pose

    def take(self, on: bool) -> None:
        onboard = self._onboard
        if onboard.ours or on == onboard.simulated:
            return
        onboard.simulated = on
        onboard.aim(onboard.body.position_rad[_ARMS])

    def aim(self, values: Sequence[float]) -> None:
        if self._onboard.simulated:
            self._onboard.aim(values)

    def hold(self) -> None:
        self.aim(self._onboard.body.position_rad[_ARMS])

    def step(self, steps: int) -> None:
        for _ in range(steps):
            self._onboard.step(TIMESTEP_S)

    def reset(self) -> None:
        self._onboard.reset()
