"""Restart child tasks that end, and stop trying when one fails too often.

A child is an async function that calls ``task_status.started()`` once it is up, and then runs until it is
cancelled. The supervisor does not need to know what the child is (an actor, a process, another supervisor).

Theory, after Erlang/OTP. ``Restart`` decides whether the end of a child leads to a restart. ``Strategy``
decides which children restart with it:

* ``one_for_one``: only the child that ended. For independent children.
* ``rest_for_one``: that child and all that were started after it. For children that use earlier ones.
* ``one_for_all``: all children. For children that depend on each other.

``Budget`` bounds the restarts. If a child still fails, a restart does not repair the cause. So the supervisor
stops its children and raises ``BudgetSpent`` to its own supervisor.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import trio

from .actor import describe

_MOST_DOUBLINGS = 30
"""The most doublings of a pause. The pause is bounded anyway, but a float would overflow after a thousand."""

Restart = Literal["permanent", "transient", "temporary"]
Strategy = Literal["one_for_one", "rest_for_one", "one_for_all"]


class BudgetSpent(Exception):
    """A child failed too often. The supervisor has stopped all its children."""


@dataclass(frozen=True)
class ChildSpec:
    """A child of a supervisor.

    Attributes:
        name: For people.
        run: The function to run.
        restart: ``permanent``: always restarted. ``transient``: only after a failure. ``temporary``: never.
        shutdown_s: Seconds that the supervisor waits for the child's end after it has cancelled it.
    """

    name: str
    run: Callable[..., Awaitable[None]]
    restart: Restart = "permanent"
    shutdown_s: float = 2.0


@dataclass(frozen=True)
class Budget:
    """The allowed restarts of all children of a supervisor.

    At most ``restarts`` happen within ``within_s`` seconds. The pause before each one doubles from
    ``backoff_s``, up to ``backoff_max_s``, while failures follow each other within ``within_s``.
    """

    restarts: int = 3
    within_s: float = 5.0
    backoff_s: float = 0.0
    backoff_max_s: float = 1.0


class _Child:
    def __init__(self, spec: ChildSpec) -> None:
        self.spec = spec
        self.scope = trio.CancelScope()
        self.done = trio.Event()
        self.done.set()
        self.starts = 0


class Supervisor:
    """Starts children in order, restarts them by strategy, and stops them in reverse order."""

    def __init__(
        self,
        specs: Sequence[ChildSpec],
        strategy: Strategy = "one_for_one",
        budget: Budget | None = None,
        on_restart: Callable[[str, str], None] | None = None,
    ) -> None:
        self._children = [_Child(spec) for spec in specs]
        self._strategy = strategy
        self._budget = budget or Budget()
        self._on_restart = on_restart
        self._failures: deque[float] = deque()
        self._running = 0
        self._ended: trio.MemorySendChannel[_End]

    @property
    def restarts(self) -> dict[str, int]:
        """Return how often each child was restarted."""
        return {child.spec.name: max(0, child.starts - 1) for child in self._children}

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Run the children. Return when every child has ended for good.

        Raises:
            BudgetSpent: A child failed too often.
        """
        self._ended, ended = trio.open_memory_channel[_End](float("inf"))
        async with trio.open_nursery() as nursery:
            try:
                for child in self._children:
                    await self._start(nursery, child)
                task_status.started()
                await self._supervise(nursery, ended)
            finally:
                await self._stop(self._children)

    async def _supervise(self, nursery: trio.Nursery, ended: trio.MemoryReceiveChannel[_End]) -> None:
        # The loop counts the children that run, because several may have ended before it handles the first end.
        while self._running:
            child, scope, error = await ended.receive()
            self._running -= 1
            if scope is not child.scope or scope.cancel_called:
                # The supervisor stopped this child, or has already restarted it with its siblings.
                continue
            restart = child.spec.restart
            if restart == "temporary" or (restart == "transient" and error is None):
                continue
            reason = "ended" if error is None else describe(error)
            pause_s = self._spend(child, reason, error)
            group = self._group(child)
            await self._stop(group)
            if pause_s:
                await trio.sleep(pause_s)
            for member in group:
                if member is child or member.spec.restart != "temporary":
                    await self._start(nursery, member)
            if self._on_restart is not None:
                self._on_restart(child.spec.name, reason)

    def _spend(self, child: _Child, reason: str, error: BaseException | None) -> float:
        now = trio.current_time()
        while self._failures and self._failures[0] <= now - self._budget.within_s:
            self._failures.popleft()
        if len(self._failures) >= self._budget.restarts:
            count, within_s = len(self._failures) + 1, self._budget.within_s
            raise BudgetSpent(f"{child.spec.name} failed {count} times in {within_s:g} s: {reason}") from error
        self._failures.append(now)
        doublings = min(len(self._failures) - 1, _MOST_DOUBLINGS)
        doubled: float = self._budget.backoff_s * 2**doublings
        return min(doubled, self._budget.backoff_max_s)

    def _group(self, failed: _Child) -> list[_Child]:
        if self._strategy == "one_for_one":
            return [failed]
        if self._strategy == "rest_for_one":
            return self._children[self._children.index(failed) :]
        return self._children

    async def _start(self, nursery: trio.Nursery, child: _Child) -> None:
        child.scope = trio.CancelScope(shield=True)
        child.done = trio.Event()
        child.starts += 1
        self._running += 1
        up = _Up()
        # ``nursery.start`` is not used here. If it were cancelled meanwhile, it would wait for ever for a
        # shielded child.
        nursery.start_soon(self._run_child, child, child.scope, child.done, up)
        await up.event.wait()

    async def _run_child(self, child: _Child, scope: trio.CancelScope, done: trio.Event, up: _Up) -> None:
        # Children are shielded from cancellation, so that a cancelled supervisor stops them one by one, in
        # reverse order.
        error: BaseException | None = None
        try:
            with scope:
                await child.spec.run(task_status=up)
        except Exception as failure:
            error = failure
        finally:
            up.started()
            done.set()
            self._ended.send_nowait((child, scope, error))

    async def _stop(self, children: Sequence[_Child]) -> None:
        for child in reversed(children):
            if child.done.is_set():
                continue
            child.scope.cancel()
            with trio.move_on_after(child.spec.shutdown_s, shield=True):
                await child.done.wait()


_End = tuple[_Child, trio.CancelScope, BaseException | None]
"""The incarnation that ended (identified by its scope), and its exception."""


class _Up:
    """The ``task_status`` of a child.

    Its event is also set when the child fails before it is up. Otherwise the supervisor would wait for ever.
    """

    def __init__(self) -> None:
        self.event = trio.Event()

    def started(self, value: None = None) -> None:
        self.event.set()
