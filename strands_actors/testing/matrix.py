"""The kill matrix: measure every victim with every fault on every robot that has a twin.

A *bench* is a twin, a template and a caller. The twin is a simulated robot. The caller is a script that moves it.
The template is a process that has imported everything and forks callers. Each caller ends like a script. *Jobs* are
worker processes with a bench each, which get ten trials of one cell at a time. A robot with legs has one bench.

Theory. Benches on the same computer disturb each other. This must not be hidden, and must not count against the
robot.

* A trial that is safe but past its bound is *disturbed* under two conditions. Between fault and safe frame the
  processes of tree, robot and bench together waited for a processor for more than 10 ms. And without this wait
  the trial would have kept the bound. The trial is repeated, and the page shows the number of such trials.
* A trial that is not safe, or that has setpoints after the safe frame, always counts.
* A cell with more disturbed than undisturbed trials is not called safe.
* A trial counts only if the last frame before the fault is a setpoint, so that the robot was moving.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator, Sequence

import msgspec

from strands_actors.contract.driver import Driver

from .bench import Bench, driver_of, roles_of
from .cells import Outcome, run_cell, tries
from .faults import Cell, cells_of
from .jobs import Cells, Drivers
from .pairs import Pair
from .trials import Trials


class Row(msgspec.Struct, frozen=True, omit_defaults=True):
    """The results of one cell (a victim with a fault) of one robot.

    Times are in milliseconds; None if no safe frame (stop command) came.
    """

    robot: str
    victim: str
    fault: str
    why_not: str = ""  # why the cell is not applicable; if it is set, the following fields have no meaning
    safe_state: str = ""
    trials: int = 0  # number of undisturbed trials
    median_ms: float | None = 0.0
    worst_ms: float | None = 0.0
    bound_ms: float = 0.0
    setpoints_after: int = 0
    gone_worst_ms: float = 0.0
    late: int = 0  # number of undisturbed trials in which the safe frame came after the bound
    unsafe: int = 0  # number of trials without a safe frame for the whole robot, or with a setpoint after it
    disturbed: int = 0  # number of trials that a busy computer has spoiled (see the module's docstring)
    proves: tuple[str, ...] = ()
    stories: tuple[str, ...] = ()  # the frames of each trial that is unsafe or late, as text

    @property
    def excused(self) -> bool:
        """True if a busy computer has disturbed more trials than it has left undisturbed.

        The cell then does not count as safe, even if each undisturbed trial was safe.
        """
        return self.disturbed > self.trials

    @property
    def safe(self) -> bool:
        """True if the cell is not applicable, or was measured and all its trials were safe and on time.

        A cell is not safe if a busy computer has disturbed most of its trials.
        """
        return bool(self.why_not) or (self.trials > 0 and not (self.unsafe or self.late or self.excused))


Progress = Callable[[str, Cell, int], None]
"""(robot, cell, trials so far)"""


def measure(
    robot: str,
    repeats: int = 1,
    driver_class: type[Driver] | None = None,
    only: Callable[[Cell], bool] = lambda _: True,
    progress: Progress = lambda *_: None,
) -> Iterator[Row]:
    """Measure each cell of one robot, in the order of the tables in ``faults``.

    Args:
        robot: A column of the matrix (``registering.column``).
        repeats: Number of trials for each cell, without those that a busy computer has disturbed.
        driver_class: The driver of a robot that is no part of this package.
        only: Function that returns True for each cell to be measured.
        progress: Function that is called after each trial.
    """
    with Bench(robot, driver_class) as bench:
        for cell in cells_of(bench.driver, roles_of(bench)):
            if not only(cell):
                continue
            if cell.why_not:
                yield Row(robot, cell.victim, cell.fault, cell.why_not)
                continue
            outcomes: list[Outcome] = []
            for outcome in tries(cell, bench, repeats, run_cell):
                progress(robot, cell, len(outcomes))
                outcomes.append(outcome)
            yield summary(robot, cell, outcomes)


def rows_of(drivers: Drivers, trials: Trials, cells: Cells) -> Iterator[Row]:
    """Yield a row of results for each cell of each robot, in the order of the tables in ``faults``.

    A cell is a victim with a fault.
    """
    for robot, driver_class in drivers.items():
        for cell in cells(robot, driver_of(robot, driver_class)):
            yield summary(robot, cell, () if cell.why_not else trials.of(robot, cell))


def summary(robot: str, cell: Cell | Pair, outcomes: Sequence[Outcome]) -> Row:
    """Return the row with the results of a cell (a victim with a fault).

    Its times are from the trials that a busy computer has not disturbed. Unsafe trials always count.
    """
    counted = [outcome for outcome in outcomes if not outcome.disturbed]
    if not counted:
        return Row(robot, cell.victim, cell.fault, cell.why_not, disturbed=len(outcomes), proves=cell.proves)
    times = sorted(outcome.safe_ms for outcome in counted)
    return Row(
        robot,
        cell.victim,
        cell.fault,
        "",
        counted[0].safe_state,
        len(counted),
        _rounded(statistics.median(times)),
        _rounded(times[-1]),
        round(counted[0].bound_ms),
        sum(max(0, outcome.setpoints_after) for outcome in outcomes),
        round(max(outcome.gone_ms for outcome in counted), 1),
        sum(outcome.late for outcome in counted),
        sum(not outcome.safe for outcome in outcomes),
        len(outcomes) - len(counted),
        cell.proves,
        tuple(outcome.story for outcome in counted if not outcome.safe or outcome.late),
    )


def _rounded(time_ms: float) -> float | None:
    return round(time_ms, 1) if math.isfinite(time_ms) else None


def shown(time_ms: float | None) -> str:
    """Return a time in milliseconds as text, with one decimal.

    It is ``never`` if no safe frame (stop command) came.
    """
    return "never" if time_ms is None else f"{time_ms:.1f}"


def verdict(row: Row) -> str:
    """Return the verdict on a cell for the page: safe, not safe, late, mostly disturbed or not measured."""
    if row.safe:
        return "safe"
    if row.unsafe:
        return "not safe"
    if row.late:
        return "late"
    return "mostly disturbed" if row.trials else "not measured"
