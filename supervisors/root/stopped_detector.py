"""A process that the system has stopped (SIGSTOP, Ctrl-Z, a debugger) cannot say so, and need not
be waited for.

A writer that falls silent may only be slow: a policy that holds the interpreter's lock sends
nothing for tens of milliseconds, and its setpoints have a lifetime for that. That a process is
*stopped* the system tells at once. So what a stopped writer left behind ends after a few looks, not
after its lifetime: 16 instead of 100 ms for legs. A few, not one, because a profiler stops a
process for a moment at each sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from strands_actors.contract.driver import Timing
from strands_actors.kernel.health.processor import CAN_TELL

LOOK_EVERY = 2
"""Ticks (``Timing.tick_s``)."""
LOOKS = 3
"""In a row, that show it stopped."""


def noticed_s(timing: Timing) -> float:
    """Published: from the stop of a process to what it becomes. Infinite where the system does not
    tell (macOS): there the lifetime of what it wrote has to lapse."""
    return (LOOKS + 1) * LOOK_EVERY * timing.tick_s if CAN_TELL else math.inf


class StoppedDetector:
    """Of the processes that may write. ``is_stopped`` asks the system."""

    def __init__(self, is_stopped: Callable[[int], bool]) -> None:
        self._is_stopped = is_stopped
        self._seen: dict[int, int] = {}

    def look(self, pids: Iterable[int]) -> list[int]:
        """At each of them; those that are stopped for good since this look."""
        seen = {pid: self._seen.get(pid, 0) + 1 for pid in pids if self._is_stopped(pid)}
        self._seen = seen
        return [pid for pid, looks in seen.items() if looks == LOOKS]
