"""Detect processes that send setpoints and that the operating system has suspended (SIGSTOP, Ctrl-Z, a debugger).

A writer that sends nothing may only be slow. A policy that holds the interpreter's lock sends nothing for tens of
milliseconds, and the lifetime of its setpoint covers this time. But a suspended process does not continue so soon,
and the operating system shows at once that it is suspended. So its setpoint ends after a few observations and not
after its lifetime: for legs after 16 and not 100 ms. One observation is not enough, because a profiler suspends a
process for a moment at each sample.
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
    """Return the longest time (s) from the suspension of a writer's process (SIGSTOP) until the robot holds. It is
    a published bound. It is infinite if the operating system does not show suspended processes (macOS). There the
    setpoint ends after its lifetime."""
    return (LOOKS + 1) * LOOK_EVERY * timing.tick_s if CAN_TELL else math.inf


class StoppedDetector:
    """Watch the processes that may send setpoints, to find one that the operating system has suspended (SIGSTOP).
    ``is_stopped`` returns True for the id of a suspended process."""

    def __init__(self, is_stopped: Callable[[int], bool]) -> None:
        self._is_stopped = is_stopped
        self._stopped_looks: dict[int, int] = {}

    def look(self, pids: Iterable[int]) -> list[int]:
        """Observe the processes. Return the ids of those that were suspended in ``LOOKS`` observations in a row,
        each of them once."""
        stopped_looks = {pid: self._stopped_looks.get(pid, 0) + 1 for pid in pids if self._is_stopped(pid)}
        self._stopped_looks = stopped_looks
        return [pid for pid, looks in stopped_looks.items() if looks == LOOKS]
