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
    on this connection. ``passed``: by how much it has gone on since the first one.

    ``wrap``: where stamps begin again at 0; 0: nowhere. With it, one that is up to half of that behind
    the newest is late, and tells nothing new either. So may one of a robot that has restarted: its new
    connection has ``Stamps`` of its own."""

    def __init__(self, wrap: float = 0) -> None:
        self.new_ns = 0
        self.goes_on = False
        self.passed = 0.0
        self._wrap = wrap
        self._heard_ns = 0
        self._newest: float | None = None
        self._is_first = True

    def connected(self) -> None:
        """Begin anew: what an earlier connection told says nothing of whether this one goes on."""
        self.goes_on, self._is_first = False, True

    def take(self, stamp: float, now_ns: int) -> bool:
        """Note a report, in whatever unit its stamps are. Return whether it is new."""
        is_new = self._is_new(stamp)
        if is_new:
            self.new_ns = now_ns
            self.goes_on = self.goes_on or not self._is_first
            self.passed += self._ahead(stamp)
            self._newest = stamp
        self._heard_ns, self._is_first = now_ns, False
        return is_new

    def repeats(self, now_ns: int) -> bool:
        """Return whether reports come, and are not new."""
        return self.new_ns < self._heard_ns and now_ns - self._heard_ns <= REPEATED_S * NS

    def _is_new(self, stamp: float) -> bool:
        if self._newest is None or not self._wrap:
            return stamp != self._newest
        return 0 < self._ahead(stamp) < self._wrap / 2

    def _ahead(self, stamp: float) -> float:
        """Return by how much it is ahead of the newest."""
        if self._newest is None:
            return 0.0
        ahead = stamp - self._newest
        return ahead % self._wrap if self._wrap else ahead
