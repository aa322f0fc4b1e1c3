"""How root and wire look, by their ends (pidfds) and their heartbeats (on the page that both beat
on). No I/O and no clock: it is told what was seen, and when."""

from __future__ import annotations

from collections.abc import Callable

from strands_actors.contract.driver import Timing
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health.failure_detector import FailureDetector
from strands_actors.kernel.health.processor import Standing

from .decision import Seen

LOOKS = 10
"""In the time after which a process counts as silent."""
START_S = 5.0
"""For a wire to begin to beat, as its root allows it."""

Look = Callable[[], Standing | None]


def silent_s(timing: Timing) -> float:
    """Published: how long both must be silent before the standby acts. Twice the time after which
    root and wire notice each other's silence: whoever of the two is left comes first."""
    return 2 * timing.heartbeat_ttl_s


def look_s(timing: Timing) -> float:
    """Return how often the standby looks, and beats."""
    return silent_s(timing) / LOOKS


class Watched:
    """One process. ``look`` asks how it stands with the processor: a process that waits for one is
    not silent."""

    def __init__(self, timing: Timing, look: Look = lambda: None, began_ns: int = 0) -> None:
        self._detector = FailureDetector(silent_s(timing), look_s(timing), look)
        self._start_ns = began_ns + round(START_S * NS)
        self._silent = False

    def see(self, now_ns: int, heard_ns: int, ended: bool, may_be_silent_until_ns: int = 0) -> Seen:
        """Call once per look. ``heard_ns``: its last heartbeat, 0: none yet."""
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
        """For people, of one that is silent."""
        return self._detector.told(now_ns)
