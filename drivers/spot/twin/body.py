"""Let a simulation (another program on this computer) move the simulated Spot.

Parts that a client commands follow the client. When the simulation takes the robot, it stands
up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.drivers.common.physics.body import Commander, Felt
from strands_actors.drivers.common.physics.stepped import DrawnBody
from strands_actors.drivers.spot.robots import KEYS

from .mechanism import Mechanism


class SpotBody(DrawnBody):
    axes = KEYS

    def __init__(self, mechanism: Mechanism, table: Mapping[str, Any]) -> None:
        super().__init__(table, mechanism)
        self._mechanism = mechanism

    @property
    def commanders(self) -> Sequence[Commander]:
        return (self._mechanism.commander,) * len(self.axes)

    def felt(self) -> Felt:
        mechanism = self._mechanism
        position = (*mechanism.present_twist, *mechanism.joints)
        velocity = (0.0, 0.0, 0.0, *mechanism.speeds)
        return self._felt(position, velocity)

    def pose(self) -> Sequence[float]:
        mechanism = self._mechanism
        body = mechanism.body_pose
        # The drawn model has no joints for roll and pitch.
        legs = [angle for leg in mechanism.legs_rad for angle in leg]
        return [*body.xyz, body.roll_pitch_yaw[2], *legs, *mechanism.joints]

    def energise(self, on: bool) -> None:
        mechanism = self._mechanism
        if on and mechanism.commander is Commander.NONE and not mechanism.walks:
            mechanism.power_on(at_once=True)
            mechanism.stand(Commander.SIM)
        elif not on and mechanism.commander is Commander.SIM:
            mechanism.settle()
            mechanism.commander = Commander.NONE

    def set_targets(self, values: Sequence[float]) -> None:
        mechanism = self._mechanism
        if mechanism.commander is Commander.SIM:
            vx, vy, wz, *joints = values
            mechanism.walk((vx, vy, wz), math.inf, Commander.SIM)
            mechanism.reach(dict(enumerate(joints)), Commander.SIM)

    def hold(self) -> None:
        if self._mechanism.commander is Commander.SIM:
            self._mechanism.halt()

    def reset(self) -> None:
        self._mechanism.reset()
