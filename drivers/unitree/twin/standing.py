"""Let a simulation (another program on this computer) command joints of a simulated legged robot.

The simulated onboard controller holds the robot up, and the simulation commands only the joints that it names.
While a DDS client commands torque, the simulation has no effect.
"""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.kit.motor_targets import ROWS
from strands_actors.drivers.common.physics.body import Commander, Felt
from strands_actors.drivers.common.physics.scenery import Scenery

from .onboard import Onboard


class StandingBody:
    """The body as a simulation can move it.

    ``set_targets`` accepts q, dq, tau, kp and kd of all joints, followed by a 1 or 0 for each joint. 1 means that
    the simulation commands the joint, 0 that the onboard controller holds it.
    """

    target_rows = len(ROWS) + 1

    def __init__(self, onboard: Onboard) -> None:
        self._onboard = onboard
        self._legs = onboard.body
        self._simulation_moves = False
        self.axes = onboard.model.axes
        self.spec = onboard.body.spec
        self.scenery = Scenery(onboard.body)

    @property
    def commanders(self) -> Sequence[Commander]:
        own = Commander.SIM if self._simulation_moves else Commander.NONE
        commanders = [Commander.WIRE if self._onboard.commanded else own] * len(self.axes)
        for index in self._onboard.arm_joints:
            commanders[index] = Commander.WIRE
        return commanders

    def pass_time(self) -> None:
        """Do nothing: the simulated robot advances the physics by itself, 500 times a second."""

    def felt(self) -> Felt:
        legs = self._legs
        return Felt(float(legs.data.time), legs.position_rad, legs.velocity_rad_s, legs.effort_nm, self.commanders)

    def pose(self) -> Sequence[float]:
        qpos: list[float] = self._legs.data.qpos.tolist()
        return qpos

    def energise(self, on: bool) -> None:
        self._simulation_moves = on
        if not self._onboard.commanded:
            self._onboard.obey_itself()

    def set_targets(self, values: Sequence[float]) -> None:
        if self._simulation_moves and not self._onboard.commanded:
            count = len(self.axes)
            *rows, selected = (values[count * row : count * (row + 1)] for row in range(self.target_rows))
            self._onboard.set_targets(rows, selected)

    def hold(self) -> None:
        """Let the onboard controller hold every joint, unless a DDS client commands torque."""
        if not self._onboard.commanded:
            self._onboard.obey_itself()

    def step(self, steps: int) -> None:
        self._legs.step(steps)

    def reset(self) -> None:
        self._simulation_moves = False
        self._onboard.reset()
