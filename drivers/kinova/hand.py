"""The gripper on the interface of a Gen3, as the wire process and the root's stop channel see it.

The base's ``Stop`` also stops the fingers where they are. Fingers that hold something press on [assumed]. So a
stop of the arm is all that the gripper needs, and this module sends nothing at a stop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from strands_actors.contract.wire import MotorReport, Permit
from strands_actors.drivers.common.kit.hand import AXIS, FULL, UNNAMED
from strands_actors.kernel.clock import NS

from . import protocol as p
from .client import KortexClient
from .protocol import Call, Feedback, Fingers

HAND_ID = 8
"""Number of the gripper in reports. The joints have 1 to 7."""
HAND_PERCENT_S = FULL * 150.0 / 85.0
"""Top speed of the fingers: 150 mm/s, 85 mm (data sheet)."""

WRITE_EVERY_S = 0.05
"""Least time between two targets, in seconds."""
STILL_PERCENT, PRESSES_MA = 0.5, 100.0
"""Fingers that are slower than this and take at least this current hold something [assumed]."""
NO_GRIPPER = "the base reports no gripper"


class KinovaHand:
    def __init__(self, client: KortexClient) -> None:
        self._client = client
        self._last: float | None = None  # the last target that was sent
        self._written_ns = 0
        self._fingers: Fingers | None = None
        self.stamp_ns = 0

    def take(self, feedback: Feedback, stamp_ns: int) -> None:
        """Take the gripper of a feedback."""
        self._fingers = feedback.fingers
        if self._fingers is not None:
            self.stamp_ns = stamp_ns

    @property
    def opening(self) -> float:
        """Percent open; not a number without a gripper."""
        return math.nan if self._fingers is None else FULL - min(max(self._fingers.closed, 0.0), FULL)

    @property
    def contact(self) -> float:
        """1 if it holds something, 0 if not."""
        fingers = self._fingers
        return math.nan if fingers is None else float(not _moves(fingers) and fingers.current_ma >= PRESSES_MA)

    @property
    def fault(self) -> str:
        if self._fingers is None:
            return NO_GRIPPER
        refusal = self._client.hand_refusal
        return "" if refusal is None else refusal.text

    def arm(self) -> None:
        """Forget the last target and a refusal."""
        self._last, self._client.hand_refusal = None, None

    def follow(self, opening: float, speed: float, now_ns: int, permit: Permit) -> None:
        """Send a target, if it is new and the last one was not just before. A later call sends it otherwise."""
        if speed == UNNAMED or opening == self._last or now_ns - self._written_ns < WRITE_EVERY_S * NS:
            return
        permit.check()
        self._client.tell(Call.SEND_GRIPPER_COMMAND, p.encode_gripper(1.0 - opening / FULL))
        self._last, self._written_ns = opening, now_ns

    @property
    def held_at(self) -> float:
        """Where the gripper is after a stop: its target, or its position if it had no target or has not arrived."""
        return self.opening if self._last is None or self.contact != 1.0 else self._last


def hand_report(joints: Sequence[MotorReport], fingers: Fingers | None, target: float | None = None) -> MotorReport:
    """Return the report on a stop of the gripper, which the stop of the arm has stopped, too.

    Args:
        joints: The reports of the joints.
        fingers: The newest measurement of the gripper since the stop.
        target: Where it is held.
    """
    arm = joints[0]
    if not arm.acknowledged:
        detail = arm.detail or "the base has not acknowledged the stop"
    elif fingers is None:
        detail = NO_GRIPPER
    else:
        detail = "the fingers move" if _moves(fingers) else ""
    return MotorReport(AXIS, HAND_ID, arm.written, arm.acknowledged, not detail, detail, target)


def _moves(fingers: Fingers) -> bool:
    return abs(fingers.speed) >= STILL_PERCENT
