"""Decide whether root and wire run. A pidfd shows that a process has ended, and a shared page has its heartbeats.

Pure: the caller passes in every observation and its time.
"""

from __future__ import annotations

from collections.abc import Callable

from strands_actors.contract.driver import Timing
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health.failure_detector import FailureDetector
from strands_actors.kernel.health.processor import ProcessorUse

from .decision import ProcessState

LOOKS = 10
"""Observations within the time after which a process counts as silent."""
START_S = 5.0
"""Time allowed for a new wire to send its first heartbeat; its root allows the same."""

Look = Callable[[], ProcessorUse | None]


def silent_s(timing: Timing) -> float:
    """Return for how many seconds root and wire must be silent before the standby acts. It is a published bound.

    It is twice the time after which root and wire notice that the other one is silent. So if one of them still
    runs, it acts before the standby does.
    """
    return 2 * timing.heartbeat_ttl_s


def look_s(timing: Timing) -> float:
    """Return the period in which the standby observes root and wire and sends its own heartbeat."""
    return silent_s(timing) / LOOKS


class Watched:
    """Watch one process.

    Args:
        timing: The timing of the driver.
        look: Returns whether the process waits for a processor. A process that waits does not count as silent.
        began_ns: When the process was started.
    """

    def __init__(self, timing: Timing, look: Look = lambda: None, began_ns: int = 0) -> None:
        self._detector = FailureDetector(silent_s(timing), look_s(timing), look)
        self._start_ns = began_ns + round(START_S * NS)
        self._silent = False

    def see(self, now_ns: int, last_received_ns: int, ended: bool, may_be_silent_until_ns: int = 0) -> ProcessState:
        """Return the state of the process. This is called once per observation.

        Args:
            now_ns: The time of the observation.
            last_received_ns: The time of the last heartbeat; 0 if there was no heartbeat yet.
            ended: True if the process has exited.
            may_be_silent_until_ns: The process has announced that it may send no heartbeats until this time.
        """
        if ended:
            return ProcessState.ENDED
        if self._detector.note_heartbeat(last_received_ns):
            self._silent = False
        if not self._detector.last_received_ns:
            return ProcessState.SILENT if now_ns >= self._start_ns else ProcessState.RUNS
        if self._detector.tick(now_ns):
            self._silent = now_ns >= may_be_silent_until_ns
        return ProcessState.SILENT if self._silent else ProcessState.RUNS

    def describe_silence(self, now_ns: int) -> str:
        """Return a text for people: for how long the process has been silent."""
        return self._detector.describe_silence(now_ns)
