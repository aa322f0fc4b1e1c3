"""Measure how long processes waited for a processor, to tell a slow tree from a busy machine.

Linux reports this (``/proc/<pid>/task/<tid>/schedstat``). Elsewhere the time counts as zero, so a late trial is
late.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator

from strands_actors.kernel.health.processor import Standing, standing

DISTURBED_MS = 10.0
"""Less than this is no disturbance. A process waits a little for its turn on an idle machine, too."""


class Queue:
    """Measures the waits of some processes from now on.

    Args:
        pids: The processes.
        mortal: One of them that may end before the measurement does. ``look`` reads its time meanwhile. Any
            other process that ends, or begins, counts as not having waited.
    """

    def __init__(self, pids: Iterable[int], mortal: int = 0) -> None:
        self._before = {pid: dict(_threads(pid)) for pid in pids}
        self._mortal = mortal
        self._seen = self._before.get(mortal, {}).get(mortal)

    def look(self) -> None:
        """Read the time of the process that may end, while it still can be read."""
        self._seen = standing(self._mortal) or self._seen

    def stood_ms(self) -> float:
        """Return the waits of all processes together, in milliseconds.

        Of each process only the thread with the longest wait counts.
        """
        return sum(self._longest_ns(pid, before) for pid, before in self._before.items()) / 1e6

    def _longest_ns(self, pid: int, before: dict[int, Standing]) -> int:
        after = dict(_threads(pid))
        if pid == self._mortal and not after and self._seen is not None:
            after = {pid: self._seen}
        threads = before.keys() & after
        return max((after[thread].waited_ns - before[thread].waited_ns for thread in threads), default=0)


def _threads(pid: int) -> Iterator[tuple[int, Standing]]:
    try:
        threads = os.listdir(f"/proc/{pid}/task")
    except OSError:
        return
    for thread in map(int, threads):
        if (stands := standing(pid, thread)) is not None:
            yield thread, stands
