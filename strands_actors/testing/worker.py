"""Run one bench of a kill matrix as a process: ``python -m strands_actors.testing.worker``.

The worker reads orders from standard input, one JSON line each (``Order``). For each order it writes one line per
trial, and then ``Done``. It keeps the bench (a simulated robot and the script that moves it) while orders are for
the same robot. It ends when standard input ends.
"""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator

import msgspec

from .bench import Bench, NotMoving
from .cells import Outcome, run_cell, tries
from .lowering_trials import run_lowering
from .pair_trials import run_pair
from .pairs import Pair
from .registering import LOWERING, class_of, prepare
from .trials import Done, Trial, cell_named, encode, trial


class Order(msgspec.Struct, frozen=True):
    """An order for some trials of one cell (a victim with a fault).

    ``driver`` is the ``module:Class`` of a driver of another package, or empty.
    """

    robot: str
    driver: str
    victim: str
    fault: str
    trials: int


class Worker:
    """Carry out orders for trials.

    Keep the bench (the simulated robot and its script) while orders are for the same robot.
    """

    def __init__(self) -> None:
        self._bench: Bench | None = None
        self._bench_key = ("", "")

    def obey(self, order: Order) -> Iterator[Trial]:
        """Carry out an order, and yield its trials. If the bench is of another robot, close it first.

        Raises:
            NotMoving: The robot cannot be made to move.
        """
        bench = self._bench_for(order)
        for outcome in self._tries(order, bench):
            yield trial(order.robot, outcome)

    def _tries(self, order: Order, bench: Bench) -> Iterator[Outcome]:
        cell = cell_named(order.victim, order.fault)
        if order.robot.endswith(LOWERING):
            return tries(cell, bench, order.trials, run_lowering)
        if isinstance(cell, Pair):
            return tries(cell, bench, order.trials, run_pair)
        return tries(cell, bench, order.trials, run_cell)

    def close(self) -> None:
        """Close the bench (the simulated robot and its script), if there is one."""
        bench, self._bench = self._bench, None
        if bench is not None:
            bench.__exit__(None, None, None)

    def _bench_for(self, order: Order) -> Bench:
        key = order.robot, order.driver
        if self._bench is None or key != self._bench_key:
            self.close()
            prepare(order.robot, order.driver)
            self._bench, self._bench_key = Bench(order.robot, class_of(order.driver)).__enter__(), key
        return self._bench


def main() -> None:
    """Carry out the orders on standard input until it ends. For each order, write each trial, then ``Done``."""
    # A shell makes background jobs ignore SIGINT. The children would inherit that, so restore the default.
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
                worker.close()  # the next order starts with a new bench
            sys.stdout.buffer.write(encode(Done(problem)))
            sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
