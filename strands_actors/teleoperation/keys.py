"""Keys of a terminal as an operator's hold on a robot. Pure.

A terminal tells of a key that goes down, and of it again and again while it is held, never that it
was let go. So a key counts as held until the next repeat is overdue.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

UP = "qwertyuiop"
DOWN = "asdfghjkl;"
DEADMAN = " "

TAP_S = 0.12
"""What one stroke is worth: a small step."""
REPEAT_S = 0.2
"""A key that repeats is let go when it is silent for so long."""
DELAY_S = 0.7
"""Until the first repeat comes, as terminals are set up."""


class Hold(NamedTuple):
    held: bool
    rates: dict[str, float]


class Keys:
    """``axes``: each with a key for up and one for down, as many as there are keys; none for a
    leader, whose dead-man is the space bar."""

    def __init__(self, axes: Sequence[str]) -> None:
        self.bindings = {
            key: (axis, rate)
            for axis, up, down in zip(axes, UP, DOWN, strict=False)
            for key, rate in ((up, 1.0), (down, -1.0))
        }
        self._deadman = not axes
        self._last_s: dict[str, float] = {}
        self._until_s: dict[str, float] = {}

    def press(self, key: str, now_s: float) -> bool:
        """Take one stroke up. Return whether it means anything."""
        if key not in self.bindings and not (self._deadman and key == DEADMAN):
            return False
        repeats = now_s - self._last_s.get(key, -DELAY_S) < DELAY_S
        first_s = DELAY_S if key == DEADMAN else TAP_S
        self._last_s[key] = now_s
        self._until_s[key] = now_s + (REPEAT_S if repeats else first_s)
        return True

    def hold(self, now_s: float) -> Hold:
        """Return what is held now."""
        down = [key for key, until_s in self._until_s.items() if now_s < until_s]
        rates: dict[str, float] = {}
        for key in down:
            if key in self.bindings:
                axis, rate = self.bindings[key]
                rates[axis] = rates.get(axis, 0.0) + rate
        return Hold(bool(down), rates)

    def release(self) -> None:
        """Nothing is held any more."""
        self._until_s.clear()
