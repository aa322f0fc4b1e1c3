"""Several benches side by side, each a ``worker`` process, until every cell has its trials.

Orders are a few trials of one cell. A worker keeps its robot as long as there are orders for it; a
robot whose bound is shorter than ``SHORT_S`` has one bench only, and the first.
"""

from __future__ import annotations

import subprocess
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping

import msgspec
import trio

from strands_actors.contract.driver import Driver
from strands_actors.kernel.processes.interpreter import PYTHON, environment

from .bench import driver_of
from .faults import Cell
from .pairs import Pair
from .registering import where_is
from .trials import Done, Trial, Trials, decode
from .worker import Order

AT_ONCE = 10
"""Trials of an order: few enough that the workers end together."""
END_S = 15.0
"""For a worker whose trial is not over."""
SHORT_S = 0.05
"""What is promised within less takes most of a processor, and is measured by one bench at a time."""
ATTEMPTS = 3
"""An order that fails so often is given up; the others are not."""

Drivers = Mapping[str, type[Driver] | None]
"""Robots; with the driver's class, where this package does not know it."""


Cells = Callable[[str, Driver], Iterable[Cell | Pair]]
"""Of a robot and its driver."""


class Plan:
    """What is left to do. ``victims``: only cells with one of these; empty: all."""

    def __init__(
        self,
        drivers: Drivers,
        repeats: int,
        trials: Trials,
        cells: Cells,
        victims: frozenset[str] = frozenset(),
    ) -> None:
        self._left: dict[str, deque[Order]] = {}
        self._benches = dict.fromkeys(drivers, 0)
        self._alone = set[str]()
        for robot, driver_class in drivers.items():
            driver = driver_of(robot, driver_class)
            where = "" if driver_class is None else where_is(driver_class)
            if driver.bound_s < SHORT_S:
                self._alone.add(robot)
            wanted = [
                cell
                for cell in cells(robot, driver)
                if not cell.why_not and (not victims or victims & frozenset(cell.members))
            ]
            self._left[robot] = deque(
                order
                for cell in wanted
                for order in _orders(robot, where, cell, _missing(trials, robot, cell, repeats))
            )

        for number, orders in enumerate(self._left.values()):
            # not every robot's callers spin at once: each begins elsewhere in the table
            orders.rotate(-number * len(orders) // len(self._left))

    def next_for(self, robot: str) -> Order | None:
        """For a worker with a bench of ``robot``, or with none yet (empty)."""
        if robot and self._left[robot]:
            return self._left[robot].popleft()
        if robot:
            self._benches[robot] -= 1
        free = [
            name for name in self._left if self._left[name] and not (name in self._alone and self._benches[name])
        ]
        if not free:
            return None
        chosen = max(
            free, key=lambda name: (name in self._alone, len(self._left[name]) / (1 + self._benches[name]))
        )
        self._benches[chosen] += 1
        return self._left[chosen].popleft()


def _missing(trials: Trials, robot: str, cell: Cell | Pair, repeats: int) -> int:
    """So many more, unless as many as that were disturbed already."""
    known = trials.of(robot, cell)
    good = sum(not outcome.disturbed for outcome in known)
    return max(0, repeats - good) if len(known) < 2 * repeats else 0


def _orders(robot: str, where: str, cell: Cell | Pair, trials: int) -> Iterator[Order]:
    for done in range(0, trials, AT_ONCE):
        yield Order(robot, where, cell.victim, cell.fault, min(AT_ONCE, trials - done))


async def measure_all(plan: Plan, jobs: int, heard: Callable[[Trial], None]) -> list[str]:
    """Tell every trial to ``heard`` as it comes; what could not be measured, in words."""
    problems: list[str] = []
    async with trio.open_nursery() as nursery:
        for _ in range(jobs):
            nursery.start_soon(_work, plan, heard, problems)
    return problems


async def _work(plan: Plan, heard: Callable[[Trial], None], problems: list[str]) -> None:
    worker = _Worker(heard)
    try:
        order = plan.next_for("")
        while order is not None:
            if problem := await _persevere(worker, order):
                problems.append(problem)
            order = plan.next_for(order.robot)
    finally:
        with trio.CancelScope(shield=True):
            await worker.end()


async def _persevere(worker: _Worker, order: Order) -> str:
    """Why it has fewer trials than ordered; empty: it has not."""
    problem = ""
    for _ in range(ATTEMPTS):
        problem = await worker.carry_out(order)
        order = msgspec.structs.replace(order, trials=order.trials - worker.undisturbed)
        if not problem or order.trials <= 0:
            return ""
    return problem


class _Worker:
    """A process with a bench; another one when it has ended."""

    def __init__(self, heard: Callable[[Trial], None]) -> None:
        self._heard = heard
        self._process: trio.Process | None = None
        self._said = b""
        self.undisturbed = 0
        """Trials of the last order."""

    async def carry_out(self, order: Order) -> str:
        """Why not all of it; empty: all of it."""
        self.undisturbed = 0
        process = self._process or await self._begin()
        assert process.stdin is not None
        try:
            await process.stdin.send_all(msgspec.json.encode(order) + b"\n")
            while line := await self._line(process):
                match decode(line):
                    case Done(problem=problem):
                        return problem
                    case Trial() as trial:
                        self.undisturbed += not trial.outcome.disturbed
                        self._heard(trial)
        except trio.BrokenResourceError:
            pass
        self._process = None
        return f"{order.robot}, {order.victim} {order.fault}: the bench ended with code {await process.wait()}"

    async def end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        await process.stdin.aclose()
        with trio.move_on_after(END_S):
            await process.wait()
            return
        process.kill()
        await process.wait()

    async def _begin(self) -> trio.Process:
        self._said = b""
        self._process = await trio.lowlevel.open_process(
            [*PYTHON, "-m", "strands_actors.testing.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment(),
        )
        return self._process

    async def _line(self, process: trio.Process) -> bytes:
        """Empty: it has ended."""
        assert process.stdout is not None
        while b"\n" not in self._said:
            data = await process.stdout.receive_some()
            if not data:
                return b""
            self._said += data
        line, _, self._said = self._said.partition(b"\n")
        return line
