"""Turn key presses of a terminal into a dead-man and rates. Pure.

A terminal reports that a key is pressed, and repeats this while the key is held. It never reports a release. So a
key counts as held until its next repeat is overdue.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

UP = "qwertyuiop"
DOWN = "asdfghjkl;"
DEADMAN = " "

TAP_S = 0.12
"""How long a single stroke counts as held. It makes a small step."""
REPEAT_S = 0.2
"""A repeating key counts as released after so long without a repeat."""
DELAY_S = 0.7
"""Longest delay until the first repeat, as terminals are usually set."""


class Hold(NamedTuple):
    """The keys that an operator holds.

    Attributes:
        held: True if any key is held.
        rates: Speed by axis, as a share (-1 to 1) of the highest speed at which an operator can move the axis.
    """

    held: bool
    rates: dict[str, float]


class Keys:
    """The keyboard of an operator.

    Args:
        axes: The axes to move. Each axis gets a key for each direction, as long as there are keys. Empty if a
            leader moves the robot; then the space bar is the dead-man.
    """

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
        """Process one key press. Return True if the key has a meaning."""
        if key not in self.bindings and not (self._deadman and key == DEADMAN):
            return False
        repeats = now_s - self._last_s.get(key, -DELAY_S) < DELAY_S
        first_s = DELAY_S if key == DEADMAN else TAP_S
        self._last_s[key] = now_s
        self._until_s[key] = now_s + (REPEAT_S if repeats else first_s)
        return True

    def hold(self, now_s: float) -> Hold:
        """Return the keys that are held now."""
        down = [key for key, until_s in self._until_s.items() if now_s < until_s]
        rates: dict[str, float] = {}
        for key in down:
            if key in self.bindings:
                axis, rate = self.bindings[key]
                rates[axis] = rates.get(axis, 0.0) + rate
        return Hold(bool(down), rates)

    def release(self) -> None:
        """Treat all keys as released."""
        self._until_s.clear()
