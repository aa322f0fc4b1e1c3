"""Let a simulation drive the twin's robot.

Parts that the wire drives follow the wire. When the simulation takes the robot, it stands up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from strands_actors.drivers.common.physics.body import TIMESTEP_S, Felt, Hand
from strands_actors.drivers.spot.robots import KEYS

from .mechanism import Mechanism


class SpotBody:
    axes = KEYS

    def __init__(self, mechanism: Mechanism, table: Mapping[str, Any]) -> None:
        self._mechanism = mechanism
        self._table = table
        self.pass_time = mechanism.pass_time

    @cached_property
    def spec(self) -> Any:
        from strands_actors.drivers.common.physics.model_rows import build  # MuJoCo, for its looks only

        return build(self._table)

    @property
    def hands(self) -> Sequence[Hand]:
        return (self._mechanism.hand,) * len(self.axes)

    def felt(self) -> Felt:
        mechanism = self._mechanism
        position = (*mechanism.runs, *mechanism.joints)
        velocity = (0.0, 0.0, 0.0, *mechanism.speeds)
        return Felt(mechanism.time_s, position, velocity, (0.0,) * len(self.axes), self.hands)

    def pose(self) -> Sequence[float]:
        mechanism = self._mechanism
        place = [mechanism.x_m, mechanism.y_m, mechanism.height_m, mechanism.yaw_rad]
        return [*place, *(mechanism.leg_rad * 4), *mechanism.joints]

    def take(self, on: bool) -> None:
        mechanism = self._mechanism
        if on and mechanism.hand is Hand.NONE and not mechanism.walks:
            mechanism.power_on(at_once=True)
            mechanism.stand(Hand.SIM)
        elif not on and mechanism.hand is Hand.SIM:
            mechanism.settle()
            mechanism.hand = Hand.NONE

    def aim(self, values: Sequence[float]) -> None:
        mechanism = self._mechanism
        if mechanism.hand is Hand.SIM:
            vx, vy, wz, *joints = values
            mechanism.walk((vx, vy, wz), math.inf, Hand.SIM)
            mechanism.reach(dict(enumerate(joints)), Hand.SIM)

    def hold(self) -> None:
        if self._mechanism.hand is Hand.SIM:
            self._mechanism.halt()

    def step(self, steps: int) -> None:
        self._mechanism.run(steps * TIMESTEP_S)

    def reset(self) -> None:
        self._mechanism.reset()
