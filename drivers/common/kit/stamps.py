"""Note when a robot last sent a new report, by the time stamp that each report has from the robot's clock.

A report is new if its stamp differs from the last one. A robot whose program is stuck repeats one stamp, so its
reports are not new. A robot that has restarted counts from 0, so its reports are new.
"""

from __future__ import annotations

from strands_actors.kernel.clock import NS

REPEATED_S = 0.2
"""Reports still come, new or not, if the last one is no older than this."""


class Stamps:
    """The time stamps in one robot's reports.

    Attributes:
        new_ns: Time at which the newest report came; 0 if there was no report.
        goes_on: True if the stamp has changed on this connection.
        passed: Difference between the newest and the first stamp.

    Args:
        wrap: Value after which the stamps start again at 0; 0 if they never do. If it is set, a stamp that is up to
            half of ``wrap`` behind the newest counts as late, not as new. After a restart a robot's stamps may look
            late, so a new connection needs new ``Stamps``.
    """

    def __init__(self, wrap: float = 0) -> None:
        self.new_ns = 0
        self.goes_on = False
        self.passed = 0.0
        self._wrap = wrap
        self._last_received_ns = 0
        self._newest: float | None = None
        self._is_first = True

    def connected(self) -> None:
        """Note that a new connection begins. ``goes_on`` becomes False until a stamp changes on this connection."""
        self.goes_on, self._is_first = False, True

    def take(self, stamp: float, now_ns: int) -> bool:
        """Note a report.

        Args:
            stamp: The report's time stamp, in any unit.
            now_ns: The time at which the report came.

        Returns:
            True if the report is new.
        """
        is_new = self._is_new(stamp)
        if is_new:
            self.new_ns = now_ns
            self.goes_on = self.goes_on or not self._is_first
            self.passed += self._ahead(stamp)
            self._newest = stamp
        self._last_received_ns, self._is_first = now_ns, False
        return is_new

    def repeats(self, now_ns: int) -> bool:
        """Return True if reports still come, but the latest of them are not new."""
        return self.new_ns < self._last_received_ns and now_ns - self._last_received_ns <= REPEATED_S * NS

    def _is_new(self, stamp: float) -> bool:
        if self._newest is None or not self._wrap:
            return stamp != self._newest
        return 0 < self._ahead(stamp) < self._wrap / 2

    def _ahead(self, stamp: float) -> float:
        """Return by how much a stamp is later than the newest stamp so far."""
        if self._newest is None:
            return 0.0
        ahead = stamp - self._newest
        return ahead % self._wrap if self._wrap else ahead
