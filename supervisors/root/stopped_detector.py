"""Detect writers that the system has stopped (SIGSTOP, Ctrl-Z, a debugger).

A silent writer may only be slow. A policy that holds the interpreter's lock sends nothing for tens of
milliseconds, and the lifetime of a setpoint covers that. A stopped process does not come back so
soon, and the system shows it at once. So the setpoint of a stopped writer ends after a few
observations instead of its lifetime: after 16 instead of 100 ms for legs. One observation is not
enough, because a profiler stops a process for a moment at each sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from strands_actors.contract.driver import Timing
from strands_actors.kernel.health.processor import CAN_TELL

LOOK_EVERY = 2
"""Ticks (``Timing.tick_s``) between two observations."""
LOOKS = 3
"""Observations in a row that show a process stopped, until it counts as stopped."""


def noticed_s(timing: Timing) -> float:
    """Return the longest time from the stop of a process to the hold, a published bound. It is infinite
    if the system does not show stopped processes (macOS); there the setpoint's lifetime counts."""
    return (LOOKS + 1) * LOOK_EVERY * timing.tick_s if CAN_TELL else math.inf


class StoppedDetector:
    """Watch the processes that may write. ``is_stopped`` asks the system about one of them."""

    def __init__(self, is_stopped: Callable[[int], bool]) -> None:
        self._is_stopped = is_stopped
        self._seen: dict[int, int] = {}

    def look(self, pids: Iterable[int]) -> list[int]:
        """Observe the processes, and return those that count as stopped since this observation."""
        seen = {pid: self._seen.get(pid, 0) + 1 for pid in pids if self._is_stopped(pid)}
        self._seen = seen
        return [pid for pid, looks in seen.items() if looks == LOOKS]
