"""Simulate a Robotiq 2F-85 on the interface of the arm, as its base shows it. No clock: the base gives the time."""

from __future__ import annotations

import enum
import math

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.physics.hand_motion import HandMotion
from strands_actors.drivers.kinova.protocol import SubError

from . import messages as m
from .errors import CallFailed

FASTEST_PER_S = 0.15 / 0.085
"""Strokes of the fingers per second at full speed: 150 mm/s, 85 mm (data sheet)."""

SUPPLY_V, ROOM_C, MILLIAMPERES = 24.0, 30.0, 200.0
"""Values for the simulated measurements [assumed]."""


class Mode(enum.IntEnum):
    FORCE = 1  # The vendor's reference calls it not implemented.
    SPEED = 2
    POSITION = 3


class Gripper:
    """``position`` is 0 for open and 1 for closed."""

    def __init__(self, motion: HandMotion | None = None) -> None:
        """Args:
        motion: The motion of fingers with physics; None for fingers that always follow.
        """
        self.motion = motion or HandMotion()
        self._fastest = FASTEST_PER_S
        self._left_s = math.inf
        self.lost = False  # True while it is not on the interface

    @property
    def position(self) -> float:
        return self.motion.closed

    @property
    def speed(self) -> float:
        """The present speed in strokes per second, positive while it closes."""
        return math.copysign(self._fastest, self.motion.goal - self.motion.motor) if self.moves else 0.0

    @property
    def moves(self) -> bool:
        return self.motion.moves

    def stop(self) -> None:
        """Stop where the fingers are. Fingers that hold an object press on [assumed]."""
        self.motion.halt()

    def obey(self, payload: bytes) -> None:
        """Carry out a ``GripperCommand``. Raise ``CallFailed`` if it is invalid."""
        fields = pb.message(payload)
        fingers = m.sub_messages(m.sub_message(fields, 2), 1)
        if len(fingers) != 1:
            raise CallFailed(SubError.INVALID_PARAM, f"{len(fingers)} fingers, not 1")
        value, duration_s = m.finite(fingers[0], 2), pb.last_int(fields, 3)
        match pb.last_int(fields, 1):
            case Mode.POSITION:
                self._require(0.0, value)
                self.move(value, 1.0)
            case Mode.SPEED:
                self._require(-1.0, value)
                # A positive speed opens the fingers.
                self.move(0.0 if value > 0.0 else 1.0, abs(value))
            case other:
                raise CallFailed(SubError.INVALID_PARAM, f"gripper mode {other}")
        self._left_s = duration_s or math.inf

    def move(self, goal: float, share_of_speed: float) -> None:
        """Move the fingers to a position, at a share (0..1) of the full speed."""
        self._fastest = share_of_speed * FASTEST_PER_S
        self._left_s = math.inf
        self.motion.move_to(goal if self._fastest else self.motion.closed)

    def pass_time(self, seconds: float) -> None:
        """Move the fingers for so long."""
        seconds = min(seconds, self._left_s)
        if self.moves:
            self._left_s -= seconds
        self.motion.advance(seconds, self._fastest)
        if self._left_s <= 0.0:
            self.stop()
            self._left_s = math.inf

    def measured(self, payload: bytes) -> bytes:
        """Return the ``Gripper`` message for a ``GripperRequest``."""
        match pb.last_int(pb.message(payload), 1):
            case Mode.POSITION:
                value = self.position
            case Mode.SPEED:
                value = -self.speed / FASTEST_PER_S
            case other:
                raise CallFailed(SubError.INVALID_PARAM, f"gripper mode {other}")
        return pb.bytes_field(1, pb.varint_field(1, 1) + pb.float_field(2, value))

    def command(self, fields: m.Fields) -> None:
        """Carry out the command of low-level servoing: position and speed in percent."""
        motors = m.sub_messages(fields, 3)
        if motors:
            goal, speed = (min(1.0, max(0.0, m.finite(motors[0], number) / 100.0)) for number in (3, 4))
            self.move(goal, speed)

    def feedback(self) -> bytes:
        """Return the feedback of the gripper, with position and speed in percent."""
        motor = (
            pb.fixed32_field(1, 1)
            + pb.float_field(4, 100.0 * self.position)
            + pb.float_field(5, 100.0 * abs(self.speed) / FASTEST_PER_S)
            + pb.float_field(7, MILLIAMPERES if self.moves or self.motion.holds else 0.0)
            + pb.float_field(8, SUPPLY_V)
            + pb.float_field(10, ROOM_C)
        )
        return pb.bytes_field(7, motor)

    def _require(self, low: float, value: float) -> None:
        if value > 1.0:
            raise CallFailed(SubError.VALUE_IS_ABOVE_MAXIMUM, f"{value} is above 1")
        if value < low:
            raise CallFailed(SubError.VALUE_IS_BELOW_MINIMUM, f"{value} is below {low:g}")
