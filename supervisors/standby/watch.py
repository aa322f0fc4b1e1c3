"""Judge whether root and wire run, from their ends (pidfds) and their heartbeats (on a shared page).

Pure: the caller passes in every observation and its time.
"""

from __future__ import annotations

from collections.abc import Callable

from strands_actors.contract.driver import Timing
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health.failure_detector import FailureDetector
from strands_actors.kernel.health.processor import Standing

from .decision import Seen

LOOKS = 10
"""Observations within the time after which a process counts as silent."""
START_S = 5.0
"""Time allowed for a new wire to send its first heartbeat; its root allows the same."""

Look = Callable[[], Standing | None]


def silent_s(timing: Timing) -> float:
    """Return how long both must be silent before the standby acts, a published bound.

    It is twice the time after which root and wire notice each other's silence, so that the one of
    them that still runs acts first.
    """
    return 2 * timing.heartbeat_ttl_s


def look_s(timing: Timing) -> float:
    """Return the period in which the standby observes the others and sends its own heartbeat."""
    return silent_s(timing) / LOOKS


class Watched:
    """One process.

    Args:
        timing: The clocks of the driver.
        look: Read whether the process waits for a processor. One that waits is not silent.
        began_ns: When the process was started.
    """

    def __init__(self, timing: Timing, look: Look = lambda: None, began_ns: int = 0) -> None:
        self._detector = FailureDetector(silent_s(timing), look_s(timing), look)
        self._start_ns = began_ns + round(START_S * NS)
        self._silent = False

    def see(self, now_ns: int, heard_ns: int, ended: bool, may_be_silent_until_ns: int = 0) -> Seen:
        """Return the state of the process. Call once per observation.

        Args:
            now_ns: The time of the observation.
            heard_ns: The time of its last heartbeat; 0 if there was none yet.
            ended: True if the process has exited.
            may_be_silent_until_ns: Until then the process has announced that it may be silent.
        """
        if ended:
            return Seen.ENDED
        if self._detector.heard(heard_ns):
            self._silent = False
        if not self._detector.heard_ns:
            return Seen.SILENT if now_ns >= self._start_ns else Seen.RUNS
        if self._detector.tick(now_ns):
            self._silent = now_ns >= may_be_silent_until_ns
        return Seen.SILENT if self._silent else Seen.RUNS

    def told(self, now_ns: int) -> str:
        """Return a text for people about a silent process."""
        return self._detector.told(now_ns)
