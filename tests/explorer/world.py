"""Simulate processes with one clock and one queue of events, all drawn from one seed."""

from __future__ import annotations

import heapq
import itertools
import os
import random
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

from .conversation import Conversation, type_name
from .loop import Loop
from .resources import Resources

BEGIN_S = 1000.0
"""Not 0, so that a time of 0 ("never") is not mistaken for the present."""

STEP_S = 30e-6
"""Longest time that a task step computes [assumed]. The mean is a third of it."""

TREE = frozenset({"caller", "root", "wire", "policy", "standby"})

DYING_S = 0.03
"""Longest time from SIGKILL until the system reports the end, seen on a busy machine."""

WAKE_S = 150e-6
"""Longest time from a message or timer to the first step of the waiting task, on a quiet machine
[assumed]."""


class Row(NamedTuple):
    """One line of a run's history.

    Attributes:
        who: A process, the wire or the plan.
    """

    t_s: float
    who: str
    what: str
    detail: str | bytes
    """Bytes are a frame between nodes, in its encoded form."""


class Exited(BaseException):
    """Ends the step in which a simulated process called ``os._exit``."""


class World:
    """The simulated computer.

    ``rng(name)`` gives each use its own random stream, so that an additional draw in one place
    does not change the others.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.now_s = self.began_s = BEGIN_S
        self.rows: list[Row] = []
        self.conversation = Conversation()
        self.processes: list[Process] = []
        self.running: Process | None = None
        self.pages: dict[int, memoryview] = {}  # by inode
        self.descriptors: list[int] = []  # to be closed
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._pids = itertools.count(100)
        self._streams: dict[str, random.Random] = {}
        self.enter: Callable[[Process], None] = lambda process: None
        """Called before a process runs."""
        self.over = False
        self.restarts = 0  # how many more times the script will be started
        self.befell: list[tuple[float, Any]] = []
        """The events of the plan that have happened, with their times. Some times are known only during
        the run."""

    def rng(self, name: str) -> random.Random:
        if name not in self._streams:
            self._streams[name] = random.Random(f"{self.seed}/{name}")
        return self._streams[name]

    def note(self, who: str, what: str, detail: str | bytes = "") -> None:
        self.rows.append(Row(self.now_s, who, what, detail))

    def at(self, t_s: float, do: Callable[[], None]) -> None:
        heapq.heappush(self._events, (t_s, next(self._order), do))

    def after(self, pause_s: float, do: Callable[[], None]) -> None:
        self.at(self.now_s + pause_s, do)

    def run(self, until_s: float) -> None:
        events = self._events
        while events and events[0][0] <= until_s and not self.over:
            t_s, _, do = heapq.heappop(events)
            self.now_s = max(self.now_s, t_s)
            do()

    def start(self, role: str, main: Callable[[Process], Awaitable[object]], parent: Process | None) -> Process:
        process = Process(self, next(self._pids), role, main, parent)
        self.processes.append(process)
        self.note(role, "starts", f"pid {process.pid}")
        process.wake()
        return process

    def find(self, role: str) -> Process | None:
        """Return the newest living process of a role."""
        return next((each for each in reversed(self.processes) if each.role == role and not each.dead), None)

    def by_pid(self, pid: int) -> Process | None:
        return next((each for each in self.processes if each.pid == pid), None)

    def look_for_end(self) -> None:
        """End the run if no process of the tree lives and no script will be started again."""
        if not self.restarts and not any(process.role in TREE and not process.dead for process in self.processes):
            self.over = True

    @property
    def current(self) -> Process:
        """Return the process that runs now."""
        assert self.running is not None
        return self.running

    def close(self) -> None:
        """Close the real descriptors. The loops live as long as the world."""
        self.over = True
        for process in self.processes:
            process.left_over = not process.dead
            process.dead = True
            process.loop.abandon()
            if not process.gone:
                process._go()
        for fd in self.descriptors:
            os.close(fd)


class Process:
    """A process of the tree.

    It changes the world only through objects that check first whether it is ``dead``.
    """

    def __init__(
        self,
        world: World,
        pid: int,
        role: str,
        main: Callable[[Process], Awaitable[object]],
        parent: Process | None,
    ) -> None:
        self.world = world
        self.pid = pid
        self.role = role
        self.parent = parent
        self.dead = False
        """True once it runs no more code."""
        self.by_plan = False
        """True if the plan ended it, and not the tree."""
        self.gone = False
        """True once the system reports its end and has closed its descriptors."""
        self.frozen = False
        self.lag_s = 0.0
        self.resources = Resources()
        self.code: int | None = None
        self.began_s = world.now_s
        self.until_s = float("inf")
        self.frozen_times: list[tuple[float, float]] = []
        self.left_over = False
        """True if it lived when the run ended."""
        self.at_end: list[Callable[[], None]] = []
        """Called at its death, in this order. They stand for the work of the operating system."""
        self._rng = world.rng(f"processor of {role} {sum(each.role == role for each in world.processes)}")
        self._inbox: list[Callable[[], None]] = []
        self._due_s = float("inf")
        self._behind = False  # a step was due while it was frozen
        self._moments: list[tuple[str, int, Callable[[], None]]] = []  # events that wait for a message
        self._countdowns: list[
            tuple[int, Callable[[], None]]
        ] = []  # events with the steps that are left until they happen

        async def body() -> None:
            await main(self)

        self.loop = Loop(world, body, self._rng)

    def wake(self) -> None:
        """Let it run soon, because there is work for it."""
        self._schedule(self.world.now_s + self._late_s(WAKE_S))

    def post(self, do: Callable[[], None]) -> None:
        """Call ``do`` in its loop, as soon as it runs."""
        if not self.dead:
            self._inbox.append(do)
            self.wake()

    def at_moment(self, message: str, steps: int, do: Callable[[], None]) -> None:
        """Call ``do`` when its tasks have made ``steps`` steps after the next message of this type."""
        self._moments.append((message, steps, do))

    def hears(self, data: bytes) -> None:
        """Note a received frame. Events that wait for its type begin to count steps."""
        if not self._moments:
            return
        kind = type_name(data)
        for moment in [each for each in self._moments if each[0] == kind]:
            self._moments.remove(moment)
            self._countdowns.append(moment[1:])

    def kill(self, code: int = -9, by_plan: bool = False) -> None:
        if self.dead:
            return
        self.dead = True
        self.by_plan = by_plan
        self.code = code
        self.until_s = self.world.now_s
        self.world.note(self.role, "ends", f"signal {-code}" if code < 0 else f"code {code}")
        self.world.look_for_end()
        if code < 0:
            self.world.after(self._dying_s(), self._go)
        else:
            self._go()

    def _dying_s(self) -> float:
        """Draw how long a killed process takes to end, since it needs a processor for that."""
        return 0.002 * self._rng.random() if self._rng.random() < 0.8 else DYING_S * self._rng.random()

    def _go(self) -> None:
        self.gone = True
        for let_go in self.at_end:
            let_go()

    def freeze(self) -> None:
        if not self.frozen:
            self.frozen = True
            self.frozen_times.append((self.world.now_s, float("inf")))

    def go_on(self) -> None:
        if self.frozen:
            self.frozen = False
            self.frozen_times[-1] = (self.frozen_times[-1][0], self.world.now_s)
            if self._behind:
                self._behind = False
                self.wake()

    def exit(self, code: int) -> None:
        """Replace ``os._exit`` in a simulated process."""
        self.kill(code)
        raise Exited

    def _late_s(self, most_s: float) -> float:
        late_s = most_s * self._rng.random()
        if self.lag_s and self._rng.random() < 0.3:
            late_s += self.lag_s * self._rng.random()
        return late_s

    def _schedule(self, due_s: float) -> None:
        if due_s < self._due_s:
            self._due_s = due_s
            self.world.at(due_s, lambda: self._step(due_s))

    def _step(self, due_s: float) -> None:
        if self.dead or due_s != self._due_s:
            return
        self._due_s = float("inf")
        if self.frozen:
            self._behind = True
            return
        world = self.world
        world.running = self
        world.enter(self)
        try:
            more_s = self.loop.step(self._deliver)
        finally:
            world.running = None
        self._count_down()
        if self.code is not None:
            return  # it has ended in this step
        if self.loop.result is not None:
            self._ended()
        elif more_s <= 0.0:
            self._schedule(world.now_s + self._late_s(STEP_S))
        elif more_s < 3600.0:
            self._schedule(world.now_s + max(more_s, 1e-6) + self._late_s(WAKE_S))

    def _count_down(self) -> None:
        if self._countdowns:
            due = [do for steps, do in self._countdowns if steps <= 1]
            self._countdowns = [(steps - 1, do) for steps, do in self._countdowns if steps > 1]
            for do in due:
                do()

    def _deliver(self) -> None:
        inbox, self._inbox = self._inbox, []
        for do in inbox:
            do()

    def _ended(self) -> None:
        """End the process after ``main`` has returned or failed, as ``child.main`` would."""
        result: Any = self.loop.result
        error = getattr(result, "error", None)
        if error is not None:
            self.world.note(self.role, "fails", repr(error))
        self.kill(0 if error is None else 1)
