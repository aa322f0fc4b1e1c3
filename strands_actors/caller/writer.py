"""One caller's right to write to a robot: the lease, taken, kept alive and given up, and whose turn
it is."""

from __future__ import annotations

import os
from collections.abc import Callable

import trio

from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors import stop_result
from strands_actors.supervisors.gate.messages import Acquire, Beat, GetSafety, Lease, Release
from strands_actors.supervisors.stop_result import StopResult

from .processes import Processes

BEAT_S = 0.04
STALE = (Code.STALE_EPOCH, Code.NO_LEASE, Code.LEASE)
"""Refusals of a lease that was good once: an explicit new command may take it anew."""


class Writer:
    """All methods belong to the trio loop of the tree."""

    def __init__(self, processes: Processes, liveness: Callable[[], tuple[bool, float]]) -> None:
        """``liveness``: whether the caller's program lives, and how many seconds ago it last
        answered."""
        self.lease: Lease | None = None
        self.turn = trio.Lock()
        """One command of this caller at a time: the gate keeps the newest of those that wait, and
        each may take the lease anew."""
        self._processes = processes
        self._liveness = liveness

    async def acquire(self) -> Refused | None:
        """Take the lease, or take it again. None, or why not."""
        processes = self._processes
        wanted = Acquire(processes.holder, pid=os.getpid(), again=self.lease.id if self.lease else 0)
        # In the middle of a hold it is answered when that is over.
        within_s = processes.patience.ask_s + processes.driver.timing.safe_s
        answer = await processes.gate.ask(wanted, within_s)
        if isinstance(answer, Lease):
            self.lease = answer
            return None
        return answer if isinstance(answer, Refused) else Refused(Code.LEASE, "no lease")

    async def release(self) -> StopResult:
        """Give the lease up, if it is held. Return what became of what was commanded under it."""
        lease, self.lease = self.lease, None
        processes = self._processes
        wanted = GetSafety() if lease is None else Release(lease.id)
        try:
            answer = await processes.gate.ask(wanted, processes.patience.stop_s)
        except (AskTimeout, Unreachable) as failure:
            return stop_result.silent("release", busy.explained(str(failure)), processes.driver)
        return stop_result.of_answer("release", answer, processes.driver.axes)

    async def beat(self) -> None:
        """For ever: while the caller's program lives, so does the lease."""
        while True:
            await trio.sleep(BEAT_S)
            alive, answered_ago_s = self._liveness()
            if self.lease is not None and alive:
                self._processes.gate.tell(Beat(self.lease.id, answered_ago_s))
