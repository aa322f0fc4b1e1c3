"""Measure how late the messages of a web page are. Pure: the caller passes the time."""

from __future__ import annotations


class Lateness:
    """Measure the delay of messages without a common clock.

    For each message, the difference between the time of receipt and the sender's time is computed. The smallest
    difference so far counts as no delay. The delay of a message is its difference minus the smallest one. Messages
    that were stuck in a network arrive late and all at once, and must not count as new.
    """

    def __init__(self) -> None:
        self._least_ns: int | None = None

    def of(self, sent_ms: float, received_ns: int) -> int:
        """Return the delay of a message in nanoseconds.

        Args:
            sent_ms: Time of sending in milliseconds, by the sender's clock.
            received_ns: Time of receipt in nanoseconds, by this computer's clock.
        """
        passed_ns = received_ns - round(sent_ms * 1e6)
        self._least_ns = passed_ns if self._least_ns is None else min(self._least_ns, passed_ns)
        return passed_ns - self._least_ns
