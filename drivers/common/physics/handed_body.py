"""The body of a simulated arm with a hand: one more axis, the share by which the hand is closed."""

from __future__ import annotations

from collections.abc import Sequence

from .body import Commander, Felt
from .controlled_body import ControlledBody
from .hand_motion import HandMotion

AXIS = "gripper"

SAME = 0.005
"""Two positions of a hand that differ by less than this share of its travel count as equal."""


class HandedBody:
    """An arm and its hand. The simulation moves both, or commands in the robot's protocol move both."""

    def __init__(self, arm: ControlledBody, hand: HandMotion) -> None:
        self._arm, self._hand = arm, hand
        self.axes = (*arm.axes, AXIS)
        self.spec, self.scenery, self.pass_time = arm.spec, arm.scenery, arm.pass_time
        # Where the fingers were at the last energising or hold. A target there keeps the grip.
        self._kept = hand.closed

    @property
    def commanders(self) -> Sequence[Commander]:
        return [self._arm.commander] * len(self.axes)

    def felt(self) -> Felt:
        felt = self._arm.felt()
        return felt._replace(
            position=(*felt.position, self._hand.closed),
            velocity=(*felt.velocity, 0.0),
            effort=(*felt.effort, 0.0),
            commanders=self.commanders,
        )

    def pose(self) -> Sequence[float]:
        return self._arm.pose()

    def energise(self, on: bool) -> None:
        self._arm.energise(on)
        self._kept = self._hand.closed

    def set_targets(self, values: Sequence[float]) -> None:
        *arm, closed = values
        self._arm.set_targets(arm)
        if self._arm.commander is not Commander.SIM or abs(closed - self._kept) < SAME:
            # The first target of an energised robot is its position. It would loosen a grip.
            return
        self._kept = -1.0
        self._hand.move_to(closed)

    def hold(self) -> None:
        """Hold the arm at its position. Fingers that move stop. Fingers that hold an object press on."""
        self._arm.hold()
        self._hand.halt()
        self._kept = self._hand.closed

    def step(self, steps: int) -> None:
        self._arm.step(steps)

    def reset(self) -> None:
        self._arm.reset()
        self._hand.reset()


__all__ = ["HandedBody"]
