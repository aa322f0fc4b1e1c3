"""Run several benches at the same time, each in a ``worker`` process, until every cell has its trials.

A bench is a simulated robot with the script that moves it.

An order is a few trials of one cell. A worker keeps its robot as long as there are orders for this robot. A robot
with a bound below ``SHORT_S`` (for the time to a stop) has only one bench, and is measured before the others.
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
from .registering import class_path_of
from .trials import Done, Trial, Trials, decode
from .worker import Order

AT_ONCE = 10
"""Trials of an order: few enough that the workers end at about the same time."""
END_S = 15.0
"""Seconds to wait for a worker in a trial."""
SHORT_S = 0.05
"""A robot with a shorter bound (s) takes most of a processor, and is measured by one bench at a time."""
ATTEMPTS = 3
"""An order that fails so often is given up. Other orders continue."""

Drivers = Mapping[str, type[Driver] | None]
"""The robots, with the class of each driver that is no part of this package."""


Cells = Callable[[str, Driver], Iterable[Cell | Pair]]
"""Returns the cells of a robot and its driver."""


class Plan:
    """The orders (a few trials of one cell each) that are still to be carried out.

    Args:
        drivers: The robots.
        repeats: Number of trials that each cell needs, without those that a busy computer has disturbed.
        trials: The trials that were made already.
        cells: Function that returns the cells of a robot.
        victims: Measure only cells that break one of these processes. Empty for all.
    """

    def __init__(
        self,
        drivers: Drivers,
        repeats: int,
        trials: Trials,
        cells: Cells,
        victims: frozenset[str] = frozenset(),
    ) -> None:
        self._pending: dict[str, deque[Order]] = {}
        self._benches = dict.fromkeys(drivers, 0)
        self._alone = set[str]()
        for robot, driver_class in drivers.items():
            driver = driver_of(robot, driver_class)
            class_path = "" if driver_class is None else class_path_of(driver_class)
            if driver.bound_s < SHORT_S:
                self._alone.add(robot)
            chosen = [
                cell
                for cell in cells(robot, driver)
                if not cell.why_not and (not victims or victims & frozenset(cell.members))
            ]
            self._pending[robot] = deque(
                order
                for cell in chosen
                for order in _orders(robot, class_path, cell, _missing(trials, robot, cell, repeats))
            )

        for number, orders in enumerate(self._pending.values()):
            # Each robot begins at another cell, so that not all callers run endless loops at the same time.
            orders.rotate(-number * len(orders) // len(self._pending))

    def next_for(self, robot: str) -> Order | None:
        """Return the next order (trials of one cell) for a worker process.

        ``robot`` is the robot of its bench; empty if it has no bench yet.
        """
        if robot and self._pending[robot]:
            return self._pending[robot].popleft()
        if robot:
            self._benches[robot] -= 1
        free = [
            name
            for name in self._pending
            if self._pending[name] and not (name in self._alone and self._benches[name])
        ]
        if not free:
            return None
        chosen = max(
            free, key=lambda name: (name in self._alone, len(self._pending[name]) / (1 + self._benches[name]))
        )
        self._benches[chosen] += 1
        return self._pending[chosen].popleft()


def _missing(trials: Trials, robot: str, cell: Cell | Pair, repeats: int) -> int:
    """Return the number of trials that a cell still needs; 0 if twice as many as requested were made already."""
    outcomes = trials.of(robot, cell)
    good = sum(not outcome.disturbed for outcome in outcomes)
    return max(0, repeats - good) if len(outcomes) < 2 * repeats else 0


def _orders(robot: str, class_path: str, cell: Cell | Pair, trials: int) -> Iterator[Order]:
    for done in range(0, trials, AT_ONCE):
        yield Order(robot, class_path, cell.victim, cell.fault, min(AT_ONCE, trials - done))


async def measure_all(plan: Plan, jobs: int, on_trial: Callable[[Trial], None]) -> list[str]:
    """Carry out all orders for trials.

    Call ``on_trial`` with each trial when it is made. Return the problems as text.
    """
    problems: list[str] = []
    async with trio.open_nursery() as nursery:
        for _ in range(jobs):
            nursery.start_soon(_work, plan, on_trial, problems)
    return problems


async def _work(plan: Plan, on_trial: Callable[[Trial], None], problems: list[str]) -> None:
    worker = _Worker(on_trial)
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
    """Carry out an order for trials, with several attempts.

    Return why trials are missing, or an empty text if all were made.
    """
    problem = ""
    for _ in range(ATTEMPTS):
        problem = await worker.carry_out(order)
        order = msgspec.structs.replace(order, trials=order.trials - worker.undisturbed)
        if not problem or order.trials <= 0:
            return ""
    return problem


class _Worker:
    """A worker process with a bench (a simulated robot and the script that moves it).

    If the process ends, a new one is started for the next order.
    """

    def __init__(self, on_trial: Callable[[Trial], None]) -> None:
        self._on_trial = on_trial
        self._process: trio.Process | None = None
        self._received = b""
        self.undisturbed = 0
        """Undisturbed trials of the last order."""

    async def carry_out(self, order: Order) -> str:
        """Carry out an order for trials. Return the problem, or an empty text if there is no problem."""
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
                        self._on_trial(trial)
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
        self._received = b""
        self._process = await trio.lowlevel.open_process(
            [*PYTHON, "-m", "strands_actors.testing.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment(),
        )
        return self._process

    async def _line(self, process: trio.Process) -> bytes:
        """Return the next line of the worker, or empty bytes if its process has ended."""
        assert process.stdout is not None
        while b"\n" not in self._received:
            data = await process.stdout.receive_some()
            if not data:
                return b""
            self._received += data
        line, _, self._received = self._received.partition(b"\n")
        return line
