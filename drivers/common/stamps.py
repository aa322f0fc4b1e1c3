"""When a report of a robot was last new: its stamp, by the robot's own clock, is another than before.

One that comes again and again with the same stamp, from a loop that is stuck, tells nothing new. One
of a robot that has restarted, and counts from 0, does.
"""

from __future__ import annotations

from strands_actors.kernel.clock import NS

REPEATED_S = 0.2
"""A report that was heard within this time still comes, new or not."""


class Stamps:
    """``new_ns``: when the newest report came; 0: never. ``goes_on``: the stamp was seen to change,
    on this connection."""

    def __init__(self) -> None:
        self.new_ns = 0
        self.goes_on = False
        self._heard_ns = 0
        self._newest: float | None = None
        self._is_first = True

    def connected(self) -> None:
        """Begin anew: what an earlier connection told says nothing of whether this one goes on."""
        self.goes_on, self._is_first = False, True

    def take(self, stamp: float, now_ns: int) -> None:
        """Note a report, in whatever unit its stamps are."""
        if stamp != self._newest:
            self.new_ns = now_ns
            self.goes_on = self.goes_on or not self._is_first
        self._heard_ns, self._newest, self._is_first = now_ns, stamp, False

    def repeats(self, now_ns: int) -> bool:
        """Return whether reports come, and are not new."""
        return self.new_ns < self._heard_ns and now_ns - self._heard_ns <= REPEATED_S * NS
