"""Run jobs in a thread, one after the other. A job may wait for the disk or an encoder, and the event loop that
receives the robot's messages must not wait."""

from __future__ import annotations

import math
from collections.abc import Callable

import trio

Job = Callable[[], None]


class Worker:
    """A queue of jobs that are done one after the other.

    At most ``most`` frames should wait in the queue. So check ``is_full`` before queueing a frame.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._send, self._receive = trio.open_memory_channel[tuple[Job, int]](math.inf)
        self._waiting = 0
        self._idle = trio.Event()
        self._idle.set()
        self._jobs = 0

    @property
    def is_full(self) -> bool:
        return self._waiting >= self._most

    @property
    def is_busy(self) -> bool:
        return self._jobs > 0

    def put(self, job: Job, frames: int = 0) -> None:
        self._waiting += frames
        self._jobs += 1
        self._idle = trio.Event() if self._idle.is_set() else self._idle
        self._send.send_nowait((job, frames))

    async def run(self) -> None:
        """Run the queued jobs, until cancelled. If a job raises, raise its exception and run no more jobs."""
        try:
            async for job, frames in self._receive:
                await trio.to_thread.run_sync(job, abandon_on_cancel=True)
                self._waiting -= frames
                self._jobs -= 1
                if not self._jobs:
                    self._idle.set()
        finally:
            self._idle.set()

    async def drain(self) -> None:
        """Wait until all jobs are done, or ``run`` has ended."""
        await self._idle.wait()
