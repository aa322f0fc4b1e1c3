"""Move the fingers of a simulated hand: its motor goes to a goal at a speed, until it arrives or meets an object.

The positions are the share of the travel by which the hand is closed: 0 is open and 1 closed. There is no clock:
the owner gives the time that has passed.
"""

from __future__ import annotations

from typing import Protocol

_ARRIVED = 1e-6


class Fingers(Protocol):
    """Fingers with physics, which follow the motor unless something is in their way."""

    @property
    def closed(self) -> float: ...
    def is_blocked(self, goal: float) -> bool:
        """Return True if something keeps the fingers from following the motor to ``goal``."""
        ...

    def follow(self, goal: float, force: float) -> None:
        """Pull the fingers to ``goal`` with at most this share of the full force."""
        ...


class HandMotion:
    """The motion of a hand, with physical fingers, or without them with fingers that always follow.

    Args:
        fingers: The fingers in the physics of an arm; None for none.
        most: Highest goal. A motor that may press a closed hand has more than 1.
    """

    def __init__(self, fingers: Fingers | None = None, most: float = 1.0) -> None:
        self._fingers = fingers
        self._most = most
        self._motor = self.goal = 0.0
        self.force = 1.0
        # The share at which the fingers meet an object that has no physics; None without one.
        self.object_at: float | None = None
        self.stuck = False

    @property
    def closed(self) -> float:
        """The measured position of the fingers."""
        return self._motor if self._fingers is None else min(max(self._fingers.closed, 0.0), 1.0)

    @property
    def motor(self) -> float:
        """The position of the motor, which pulls fingers that have physics."""
        return self._motor

    @property
    def moves(self) -> bool:
        return not self.stuck and not self.holds and abs(self._end - self._motor) > _ARRIVED

    @property
    def holds(self) -> bool:
        """True if an object is between the fingers."""
        if self._fingers is not None and self.goal >= self._motor and self._fingers.is_blocked(self._motor):
            return True
        return (
            self.object_at is not None and abs(self._motor - self.object_at) <= _ARRIVED < self.goal - self._motor
        )

    def move_to(self, goal: float, force: float = 1.0) -> None:
        self.goal, self.force = min(max(goal, 0.0), self._most), force

    def halt(self) -> None:
        """Stop where the fingers are. Fingers that hold an object keep pressing it."""
        if self.moves:
            self.move_to(self._motor, self.force)

    def advance(self, seconds: float, speed: float) -> None:
        """Move the motor for so long, at a speed in shares of the travel per second."""
        if not self.stuck:
            reach = speed * seconds
            self._motor += min(max(self._end - self._motor, -reach), reach)
        if self._fingers is not None:
            self._fingers.follow(self._motor, self.force)

    def reset(self) -> None:
        """Open the hand at once."""
        self._motor = self.goal = 0.0

    @property
    def _end(self) -> float:
        """The goal of the motor, or the object that is in its way."""
        if self.object_at is not None and self._motor <= self.object_at + _ARRIVED:
            return min(self.goal, self.object_at)
        return self.goal


__all__ = ["Fingers", "HandMotion"]
