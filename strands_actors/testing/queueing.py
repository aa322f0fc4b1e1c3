"""Measure how long processes waited for a processor.

So a late stop of a busy computer can be distinguished from a slow program.

Linux reports this time (``/proc/<pid>/task/<tid>/schedstat``). On other systems it counts as zero, so a late trial
always counts as late.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator

from strands_actors.kernel.health.processor import ProcessorUse, processor_use

DISTURBED_MS = 10.0
"""Less than this is no disturbance. A process waits a little for its turn on an idle machine, too."""


class Queue:
    """A measurement of how long some processes wait for a processor. It begins when this object is made.

    Args:
        pids: The processes.
        mortal: One of the processes, which may end before the measurement does. ``look`` reads its waiting time
            before that. Any other process that ends or begins during the measurement counts with no wait.
    """

    def __init__(self, pids: Iterable[int], mortal: int = 0) -> None:
        self._before = {pid: dict(_threads(pid)) for pid in pids}
        self._mortal = mortal
        self._last_use = self._before.get(mortal, {}).get(mortal)

    def look(self) -> None:
        """Read the waiting time of the process that may end, while it can still be read."""
        self._last_use = processor_use(self._mortal) or self._last_use

    def waited_ms(self) -> float:
        """Return how long all processes together waited for a processor, in milliseconds.

        For each process, only the thread with the longest wait counts.
        """
        return sum(self._longest_ns(pid, before) for pid, before in self._before.items()) / 1e6

    def _longest_ns(self, pid: int, before: dict[int, ProcessorUse]) -> int:
        after = dict(_threads(pid))
        if pid == self._mortal and not after and self._last_use is not None:
            after = {pid: self._last_use}
        threads = before.keys() & after
        return max((after[thread].waited_ns - before[thread].waited_ns for thread in threads), default=0)


def _threads(pid: int) -> Iterator[tuple[int, ProcessorUse]]:
    try:
        threads = os.listdir(f"/proc/{pid}/task")
    except OSError:
        return
    for thread in map(int, threads):
        if (use := processor_use(pid, thread)) is not None:
            yield thread, use
