"""Simulate the legs: the onboard controller holds the robot up, and joints that the simulation commands
follow the simulation instead.

While the wire commands torque, the wire has the body. The simulation never takes it from the wire.
"""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.kit.motor_targets import ROWS
from strands_actors.drivers.common.physics.body import Felt, Hand
from strands_actors.drivers.common.physics.scenery import Scenery

from .onboard import Onboard


class StandingBody:
    """The body for the simulation control. ``aim`` takes the rows of a LowCmd (q, dq, tau, kp, kd) and a row
    of flags: 1 for a commanded joint, 0 for the onboard controller."""

    target_rows = len(ROWS) + 1

    def __init__(self, onboard: Onboard) -> None:
        self._onboard = onboard
        self._legs = onboard.body
        self._led = False
        self.axes = onboard.model.axes
        self.spec = onboard.body.spec
        self.scenery = Scenery(onboard.body)

    @property
    def hands(self) -> Sequence[Hand]:
        own = Hand.SIM if self._led else Hand.NONE
        return [Hand.WIRE if self._onboard.commanded else own] * len(self.axes)

    def pass_time(self) -> None:
        """Do nothing: the robot's own ticks, 500 a second, advance the physics."""

    def felt(self) -> Felt:
        legs = self._legs
        return Felt(float(legs.data.time), legs.position_rad, legs.velocity_rad_s, legs.effort_nm, self.hands)

    def pose(self) -> Sequence[float]:
        qpos: list[float] = self._legs.data.qpos.tolist()
        return qpos

    def take(self, on: bool) -> None:
        self._led = on
        if not self._onboard.commanded:
            self._onboard.obey_itself()

    def aim(self, values: Sequence[float]) -> None:
        if self._led and not self._onboard.commanded:
            count = len(self.axes)
            *rows, which = (values[count * row : count * (row + 1)] for row in range(self.target_rows))
            self._onboard.lead(rows, which)

    def hold(self) -> None:
        """Give every joint back to the onboard controller."""
        if not self._onboard.commanded:
            self._onboard.obey_itself()

    def step(self, steps: int) -> None:
        self._legs.step(steps)

    def reset(self) -> None:
        self._led = False
        self._onboard.reset()
