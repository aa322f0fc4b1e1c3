"""The kill matrix of LeRobot's own robot classes under our tree, by hand, in one of the environments:

    python -m tests.lerobot.matrix so101,koch --repeats 10 -o docs/kill-matrix-lerobot.md

It is measured as every other column is (``strands-actors matrix``), on the same twins. Columns are
of a robot and a version of LeRobot; those that are not measured stay on the page. ``--resume FILE``
keeps each trial, and goes on with those that are there. ``--only VICTIM`` measures those cells.
``--rustypot`` gives LeRobot's classes the bus of ``on_rustypot.py``.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

from strands_actors.contract.driver import Driver
from strands_actors.contract.safe_state import SafeState
from strands_actors.testing import bench, cells, twin
from strands_actors.testing.cells import run_cell, tries
from strands_actors.testing.faults import Cell, cells_of
from strands_actors.testing.matrix import rows_of, summary
from strands_actors.testing.matrix_page import columns_of, encode, load, page
from strands_actors.testing.trials import Trials, trial

from . import measured
from .their_log import read_as_theirs

IMPORTS_S = 240.0
"""For a process to import torch, on a busy machine."""
AWAY_S = 3.0
"""How long a robot is frozen or its cable out. A plain wire calls it lost after a second."""
INTRODUCTION = """\
# Kill matrix of LeRobot's own robot classes

This page is measured like [kill-matrix.md](kill-matrix.md), which explains the columns, and on the
same simulated robots. Here the wire process contains an object of LeRobot's robot class
(`driver="lerobot"`), and LeRobot's own code writes to the servo bus. LeRobot turns the torque off
servo by servo, and the last servo's frame counts as the safe frame. To hold, it sends one frame
that gives all servos their last measured positions as goals. The command `python -m
tests.lerobot.matrix so101,koch --repeats {repeats} -o docs/kill-matrix-lerobot.md` made this page,
in the environments of `python -m tests lerobot`. The page [lerobot.md](lerobot.md) lists what this
package cannot promise for such a robot.

The bounds are longer than in kill-matrix.md, because the wire process imports torch. The bound of
the driver is one second instead of 50 ms, and a process counts as frozen after 0.3 s without a
heartbeat instead of 0.1 s. The robot is frozen or unplugged for three seconds instead of one,
because its link counts as lost only after a second without a reading.
"""


class TheirBench(bench.Bench):
    def __enter__(self) -> TheirBench:
        super().__enter__()
        # LeRobot's disconnect() is torque off, and nothing else, for who reads the wire.
        its = self.driver.fallbacks
        self.driver.fallbacks = {why: SafeState.LIMP if its[why] == SafeState.OFF else its[why] for why in its}
        return self

    def _begin_twin(self) -> None:
        super()._begin_twin()
        read_as_theirs(self.twin)


def main() -> int:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    parser = argparse.ArgumentParser(prog="python -m tests.lerobot.matrix")
    parser.add_argument("robots")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--resume", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--rustypot", action="store_true")
    parser.add_argument("-o", dest="out", type=Path)
    given = parser.parse_args()
    twin.PATIENCE_S = bench.START_S = IMPORTS_S
    cells.AWAY_S = AWAY_S
    with tempfile.TemporaryDirectory(prefix="matrix-") as folder:
        os.environ |= {"HF_HOME": folder, "HF_HUB_OFFLINE": "1"}
        measured.calibrate(Path(folder))
        return _measure(given)


def _measure(given: argparse.Namespace) -> int:
    classes = measured.ON_RUSTYPOT if given.rustypot else measured.CLASSES
    drivers = {robot: classes[robot] for robot in given.robots.split(",")}
    trials = Trials(given.resume, 1)

    def wanted(robot: str, driver: Driver) -> Iterator[Cell]:
        return (cell for cell in cells_of(driver) if not given.only or cell.victim == given.only)

    problems = []
    for robot, driver_class in drivers.items():
        with TheirBench(robot, driver_class) as its_bench:
            for cell in wanted(robot, its_bench.driver):
                try:
                    _try(cell, its_bench, trials, given.repeats)
                except bench.NotMoving as why:
                    problems.append(str(why))
    rows = list(rows_of(drivers, trials, wanted))
    bus = ", bus on rustypot" if given.rustypot else ""
    columns = {
        f"{robot}, lerobot {version('lerobot')}{bus}": column for robot, column in columns_of(rows, trials).items()
    }
    if given.out is None:
        print(page(columns, INTRODUCTION))
    else:
        columns = load(given.out.with_suffix(".json")) | columns
        given.out.with_suffix(".json").write_bytes(encode(columns))
        given.out.write_text(page(columns, INTRODUCTION))
    for problem in problems:
        print(problem)
    return 1 if problems or not all(row.safe for row in rows) else 0


def _try(cell: Cell, its_bench: bench.Bench, trials: Trials, repeats: int) -> None:
    """Make the trials that the cell lacks. Raise ``NotMoving``."""
    known = sum(not outcome.disturbed for outcome in trials.of(its_bench.robot, cell))
    if cell.why_not or known >= repeats:
        return
    for outcome in tries(cell, its_bench, repeats - known, run_cell):
        trials.add(trial(its_bench.robot, outcome))
        row = summary(its_bench.robot, cell, [outcome])
        shown = "disturbed" if outcome.disturbed else f"{outcome.safe_ms:.0f} of {row.bound_ms:.0f} ms"
        print(
            f"{row.robot} {cell}: {row.safe_state} {shown}, {row.setpoints_after} after. {outcome.story}",
            flush=True,
        )


if __name__ == "__main__":
    sys.exit(main())
