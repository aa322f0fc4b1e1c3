"""Watch the programs that have attached themselves to a robot that a host keeps.

When such a program ends, the gate learns it at once. The gate also learns of the silence of its heartbeats, but
only after the lifetime of a lease.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection

from strands_actors.kernel.node import Ref
from strands_actors.kernel.processes.process import exists, wait_for_end_of
from strands_actors.supervisors.gate.messages import WriterEnded

MOST = 32
"""Most programs that are watched. The lease of a further one ends only by the silence of its heartbeats."""


class AttachedPrograms:
    """The processes of the programs that have attached themselves.

    Args:
        gate: Returns a reference to the gate.
        start_soon: Starts a task that runs as long as the root process.
    """

    def __init__(
        self, gate: Callable[[], Ref], start_soon: Callable[[Callable[[int], Awaitable[None]], int], None]
    ) -> None:
        self._gate = gate
        self._start_soon = start_soon
        self._pids: set[int] = set()

    @property
    def pids(self) -> Collection[int]:
        return self._pids

    def watch(self, pid: int) -> None:
        """Inform the gate when this process ends. A process that does not exist here is not watched: its program
        may run in a container with its own process ids."""
        if pid <= 0 or pid in self._pids or len(self._pids) >= MOST or not exists(pid):
            return
        self._pids.add(pid)
        self._start_soon(self._wait, pid)

    async def _wait(self, pid: int) -> None:
        await wait_for_end_of(pid)
        self.end(pid)

    def end(self, pid: int) -> None:
        """Inform the gate that a program has ended, or is dying. A second call does nothing."""
        if pid in self._pids:
            self._pids.discard(pid)
            self._gate().tell(WriterEnded(pid))
