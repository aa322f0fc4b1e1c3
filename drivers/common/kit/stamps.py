"""Notes when a report of a robot was last new, by its stamp from the robot's clock.

A report is new if its stamp differs from the last one. A stuck loop that repeats one stamp reports
nothing new. A robot that has restarted, and counts from 0, does.
"""

from __future__ import annotations

from strands_actors.kernel.clock import NS

REPEATED_S = 0.2
"""Reports still come, new or not, if the last one is no older than this."""


class Stamps:
    """The stamps of one robot's reports.

    Attributes:
        new_ns: When the newest report came; 0 for never.
        goes_on: True if the stamp was seen to change on this connection.
        passed: By how much the stamp has advanced since the first one.

    Args:
        wrap: Value at which stamps start again at 0; 0 for never. With it, a stamp that is up to half
            of ``wrap`` behind the newest counts as late, and is not new. After a restart a robot's stamps
            may look like that, so a new connection needs new ``Stamps``.
    """

    def __init__(self, wrap: float = 0) -> None:
        self.new_ns = 0
        self.goes_on = False
        self.passed = 0.0
        self._wrap = wrap
        self._heard_ns = 0
        self._newest: float | None = None
        self._is_first = True

    def connected(self) -> None:
        """Begin a new connection. Reports of an earlier one do not show whether this one goes on."""
        self.goes_on, self._is_first = False, True

    def take(self, stamp: float, now_ns: int) -> bool:
        """Note a report.

        Args:
            stamp: Its stamp, in any unit.
            now_ns: When it came.

        Returns:
            True if it is new.
        """
        is_new = self._is_new(stamp)
        if is_new:
            self.new_ns = now_ns
            self.goes_on = self.goes_on or not self._is_first
            self.passed += self._ahead(stamp)
            self._newest = stamp
        self._heard_ns, self._is_first = now_ns, False
        return is_new

    def repeats(self, now_ns: int) -> bool:
        """Return True if reports come, but none of them is new."""
        return self.new_ns < self._heard_ns and now_ns - self._heard_ns <= REPEATED_S * NS

    def _is_new(self, stamp: float) -> bool:
        if self._newest is None or not self._wrap:
            return stamp != self._newest
        return 0 < self._ahead(stamp) < self._wrap / 2

    def _ahead(self, stamp: float) -> float:
        """Return how far a stamp is ahead of the newest."""
        if self._newest is None:
            return 0.0
        ahead = stamp - self._newest
        return ahead % self._wrap if self._wrap else ahead
