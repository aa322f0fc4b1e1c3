"""Acquire the lease (the right to command) for a program, send its heartbeats, and release it."""

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

from ..processes.robot_processes import Processes
from . import refusals

BEAT_S = 0.04
STALE = (Code.STALE_EPOCH, Code.NO_LEASE, Code.LEASE)
"""Refusals of a lease that was valid before. A new command of the user may acquire the lease again."""


class Writer:
    """Acquire, keep and release the lease (the right to command) of one program. Only the trio loop of the
    ``RobotTree`` may call it.

    Args:
        processes: The robot's processes.
        liveness: Returns whether the caller's program is alive, and how many seconds ago it last
            answered (``Liveness.look``).
    """

    def __init__(self, processes: Processes, liveness: Callable[[], tuple[bool, float]]) -> None:
        self.lease: Lease | None = None
        self.turn = trio.Lock()
        """Lets one command of this caller run at a time. Otherwise the gate would drop all waiting commands but
        the newest, and each command could acquire the lease again.
        """
        self._processes = processes
        self._liveness = liveness

    async def acquire(self) -> Refused | None:
        """Acquire the lease (the right to command), or acquire it again. Return None, or the refusal."""
        processes = self._processes
        request = Acquire(processes.holder, pid=os.getpid(), again=self.lease.id if self.lease else 0)
        # A gate that brings the robot into a hold answers only when the robot holds.
        within_s = processes.patience.ask_s + processes.driver.timing.safe_s
        answer = await processes.gate.ask(request, within_s)
        if isinstance(answer, Lease):
            self.lease = answer
            return None
        return answer if isinstance(answer, Refused) else refusals.no_lease()

    async def release(self) -> StopResult:
        """Release the lease (the right to command), if it is held. Return the result of the hold that follows,
        otherwise that of the last stop.
        """
        lease, self.lease = self.lease, None
        processes = self._processes
        request = GetSafety() if lease is None else Release(lease.id)
        try:
            answer = await processes.gate.ask(request, processes.patience.stop_s)
        except (AskTimeout, Unreachable) as failure:
            return stop_result.silent("release", busy.explained(str(failure)), processes.driver)
        return stop_result.of_answer("release", answer, processes.driver.axes)

    async def beat(self) -> None:
        """Send heartbeats for ever, while the caller's program is alive. Without them the lease (the right to
        command) ends.
        """
        while True:
            await trio.sleep(BEAT_S)
            alive, answered_ago_s = self._liveness()
            if self.lease is not None and alive:
                self._processes.gate.tell(Beat(self.lease.id, answered_ago_s))
