"""Detect writers whose process the system has stopped (SIGSTOP, Ctrl-Z, a debugger).

A writer that sends nothing may only be slow. A policy that holds the interpreter's lock sends nothing for tens of
milliseconds, and the lifetime of its setpoint covers this time. But a stopped process does not continue so soon,
and the system shows at once that it is stopped. So its setpoint ends after a few observations and not after its
lifetime: for legs after 16 and not 100 ms. One observation is not enough, because a profiler stops a process for a
moment at each sample.
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
    """Return the longest time from the stop of a writer's process until the robot holds. It is a published bound.
    It is infinite if the system does not show stopped processes (macOS). There the setpoint ends after its
    lifetime."""
    return (LOOKS + 1) * LOOK_EVERY * timing.tick_s if CAN_TELL else math.inf


class StoppedDetector:
    """Watch the processes that may send setpoints. ``is_stopped`` returns True if the system has stopped a
    process."""

    def __init__(self, is_stopped: Callable[[int], bool]) -> None:
        self._is_stopped = is_stopped
        self._stopped_looks: dict[int, int] = {}

    def look(self, pids: Iterable[int]) -> list[int]:
        """Observe the processes. Return those that have been stopped for enough observations, each of them once."""
        stopped_looks = {pid: self._stopped_looks.get(pid, 0) + 1 for pid in pids if self._is_stopped(pid)}
        self._stopped_looks = stopped_looks
        return [pid for pid, looks in stopped_looks.items() if looks == LOOKS]
