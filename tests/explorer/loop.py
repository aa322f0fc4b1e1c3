"""Run the trio loop of one simulated process, one task step at a time.

The process can be killed, frozen or starved between any two task steps, so a fault can happen at any
``await``. The next runnable task is drawn. As in trio, all tasks of a batch run before the tasks
that became runnable meanwhile.
"""

from __future__ import annotations

import contextvars
import random
from collections.abc import Awaitable, Callable, Generator, Iterator
from typing import Any, Protocol, runtime_checkable

import outcome
import trio
from trio._core._instrumentation import Instruments
from trio._core._ki import KIManager
from trio._core._run import GLOBAL_RUN_CONTEXT, Runner, unrolled_run


class Time(Protocol):
    now_s: float


@runtime_checkable
class Readable(Protocol):
    async def readable(self) -> None: ...

    def rouse(self) -> None:
        """Wake the waiting tasks."""


class LoopClock(trio.abc.Clock):
    """Shows the loops of all processes the simulated time."""

    def __init__(self, time: Time) -> None:
        self._time = time

    def start_clock(self) -> None:
        pass

    def current_time(self) -> float:
        return self._time.now_s

    def deadline_to_sleep_time(self, deadline: float) -> float:
        return deadline - self._time.now_s


class _NoIo:
    """Replaces epoll, because no simulated process waits for a real descriptor.

    A simulated socket has its own method ``readable``.
    """

    def process_events(self, events: object) -> None:
        pass

    def force_wakeup(self) -> None:
        pass

    async def wait_readable(self, fd: object) -> None:
        if isinstance(fd, Readable):
            await fd.readable()
        else:
            await trio.sleep_forever()

    wait_writable = wait_readable

    def notify_closing(self, fd: object) -> None:
        if isinstance(fd, Readable):
            fd.rouse()

    def close(self) -> None:
        pass


class _RunQueue:
    """Hands out one runnable task at a time (trio takes ``list(queue)``, then calls ``clear``)."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._batch: list[Any] = []
        self._next: list[Any] = []

    def __bool__(self) -> bool:
        return bool(self._batch or self._next)

    def append(self, task: Any) -> None:
        self._next.append(task)

    def __iter__(self) -> Iterator[Any]:
        if not self._batch and self._next:
            # Trio's sets of tasks are unordered. Sort them by creation, so that only the draw decides.
            self._batch, self._next = sorted(self._next, key=lambda task: task._counter), []
            if len(self._batch) > 1:
                self._rng.shuffle(self._batch)
        return iter(self._batch[-1:])

    def clear(self) -> None:
        if self._batch:
            self._batch.pop()


class Loop:
    """Runs ``main`` of one process. ``step`` runs one task up to its next ``await``."""

    def __init__(self, time: Time, main: Callable[[], Awaitable[object]], rng: random.Random) -> None:
        self._runner = Runner(
            clock=LoopClock(time),
            instruments=Instruments(()),
            io_manager=_NoIo(),  # type: ignore[arg-type]
            system_context=contextvars.copy_context(),
            ki_manager=KIManager(),
            strict_exception_groups=True,
        )
        self._runner.runq = _RunQueue(rng)  # type: ignore[assignment]
        self._run: Generator[float, Any, None] = unrolled_run(self._runner, main, (), True)
        self._begun = False
        self.result: outcome.Outcome[object] | None = None
        """The outcome of ``main``; None until it has ended."""

    def step(self, before: Callable[[], None]) -> float:
        """Call ``before`` in the loop, then run one task.

        Returns:
            Seconds until the loop must run again, at the latest; 0 if a task is runnable now.
        """
        context = GLOBAL_RUN_CONTEXT
        context.runner = self._runner
        try:
            if not self._begun:
                self._begun = True
                next(self._run)
            before()
            return self._run.send(())
        except StopIteration:
            self.result = self._runner.main_task_outcome
            return float("inf")
        finally:
            context.__dict__.clear()

    def abandon(self) -> None:
        """Close the real descriptors. The tasks stay suspended, because a killed process runs no
        ``finally``."""
        if self.result is None:
            self._runner.entry_queue.close()
