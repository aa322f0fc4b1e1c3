"""Run one bench of a matrix as a process: ``python -m strands_actors.testing.worker``.

It reads orders on standard input, one JSON line each (``Order``). It writes one line for each trial, then
``Done``. It keeps the bench while orders are for the same robot, and ends with its input.
"""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator

import msgspec

from .bench import Bench, NotMoving
from .cells import Outcome, run_cell, tries
from .pair_trials import run_pair
from .pairs import Pair
from .registering import class_of, prepare
from .trials import Done, Trial, cell_named, encode, trial


class Order(msgspec.Struct, frozen=True):
    """An order for some trials of one cell.

    ``driver`` is ``module:Class`` of a robot that is no part of this package, or empty.
    """

    robot: str
    driver: str
    victim: str
    fault: str
    trials: int


class Worker:
    """A bench that is kept while orders are for the same robot."""

    def __init__(self) -> None:
        self._bench: Bench | None = None
        self._whose = ("", "")

    def obey(self, order: Order) -> Iterator[Trial]:
        """Yield the trials of an order. A bench of another robot is closed first.

        Raises:
            NotMoving: The robot cannot be made to move.
        """
        bench = self._bench_for(order)
        for outcome in self._tries(order, bench):
            yield trial(order.robot, outcome)

    def _tries(self, order: Order, bench: Bench) -> Iterator[Outcome]:
        cell = cell_named(order.victim, order.fault)
        if isinstance(cell, Pair):
            return tries(cell, bench, order.trials, run_pair)
        return tries(cell, bench, order.trials, run_cell)

    def close(self) -> None:
        """Close the bench, if there is one."""
        bench, self._bench = self._bench, None
        if bench is not None:
            bench.__exit__(None, None, None)

    def _bench_for(self, order: Order) -> Bench:
        whose = order.robot, order.driver
        if self._bench is None or whose != self._whose:
            self.close()
            prepare(order.robot, order.driver)
            self._bench, self._whose = Bench(order.robot, class_of(order.driver)).__enter__(), whose
        return self._bench


def main() -> None:
    """Carry out the orders on standard input until it ends. Write each trial, then ``Done``."""
    # A background job of a shell ignores this signal, and its children would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    worker = Worker()
    with contextlib.closing(worker), contextlib.suppress(KeyboardInterrupt, BrokenPipeError):
        for line in sys.stdin.buffer:
            problem = ""
            try:
                for done in worker.obey(msgspec.json.decode(line, type=Order)):
                    sys.stdout.buffer.write(encode(done))
                    sys.stdout.buffer.flush()
            except (NotMoving, RuntimeError, TimeoutError) as failure:
                problem = str(failure)
                worker.close()  # the next order gets a new robot
            sys.stdout.buffer.write(encode(Done(problem)))
            sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
