"""``matrix``: break each process and connection of every simulated robot, and report how the robot was
stopped."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec
import trio

from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class, list_native_drivers
from strands_actors.testing import trials as testing_trials
from strands_actors.testing.bench import Bench, NotMoving, roles_of
from strands_actors.testing.faults import Cell, Victims, cells_of
from strands_actors.testing.jobs import Plan, measure_all
from strands_actors.testing.lowering_trials import lowering_cells
from strands_actors.testing.matrix import Row, rows_of, shown, summary, verdict
from strands_actors.testing.matrix_page import INTRODUCTION, PAIRS, Columns, columns_of, encode, load, page
from strands_actors.testing.pairs import Pair, pairs_of
from strands_actors.testing.registering import HOSTED, LOWERING, column, end_of
from strands_actors.testing.trials import Trial, Trials, cell_named

from .errors import Problem

CLEAR = "\r\x1b[K"


def run(
    drivers: str | None,
    repeats: int,
    out: Path | None,
    json: bool,
    jobs: int = 1,
    resume: Path | None = None,
    pairs: bool = False,
    victims: str | None = None,
) -> int:
    """Break each process of each robot ("kill matrix"), measure, and write the result as a page.

    A cell of the matrix is one robot with one fault. Return 1 if a robot was not stopped in time, else 0.

    Args:
        drivers: Names of robots, separated by commas. None for one robot of each driver.
        repeats: Trials per cell.
        out: The page. If it exists, the columns of other robots are kept. None prints the page.
        json: Print JSON.
        jobs: Number of robots that are broken at the same time.
        resume: A file in which each trial is saved. Trials that it already has are not repeated.
        pairs: Break two processes, one shortly after the other.
        victims: Names of processes, separated by commas. Only cells that break one of them are measured. None
            for all cells.

    Raises:
        Problem: An argument is wrong, or a cell cannot be measured. The other cells are written nevertheless.
    """
    if pairs and drivers and HOSTED in drivers:
        raise Problem("matrix: pairs are not measured on a robot that a host keeps. Leave out --pairs")
    robots = dict.fromkeys(_chosen(drivers) if drivers else [*every_column(), *lowering_columns()])
    kept = {} if out is None else _kept(out)
    roles = _roles_of(robots)
    of: Callable[[Driver, Iterable[str]], Iterable[Cell | Pair]] = pairs_of if pairs else cells_of

    def cells(robot: str, driver: Driver) -> Iterable[Cell | Pair]:
        usual_cells = of(driver, roles[robot])
        return lowering_cells(usual_cells) if robot.endswith(LOWERING) else usual_cells

    only = frozenset(name.strip() for name in (victims or "").split(",") if name.strip())
    names = {role for process_names in roles.values() for role in process_names} | set(Victims)
    if unknown := sorted(only - names):
        raise Problem(f"matrix: no process {', '.join(unknown)}. There are {', '.join(sorted(names))}")
    try:
        trials = Trials(resume, jobs)
    except testing_trials.Problem as problem:
        raise Problem(f"matrix: {problem}") from None
    problems = trio.run(
        measure_all, Plan(robots, repeats, trials, cells, only), jobs, _Progress(trials, repeats).add
    )
    rows = list(rows_of(robots, trials, cells))
    columns = columns_of(rows, trials)
    written = page(kept | columns, PAIRS if pairs else INTRODUCTION)
    if out is not None:
        out.with_suffix(".json").write_bytes(encode(kept | columns))
        out.write_text(written)
    if json:
        print(encode(columns).decode())
    elif out is None:
        print(written)
    if problems:
        raise Problem(f"matrix: {problems[0]}" + (f" (and {len(problems) - 1} more)" if problems[1:] else ""))
    return 0 if all(row.safe for row in rows) else 1


def _roles_of(robots: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return the names of each robot's processes. To find them, each robot is started once."""
    roles = {}
    for robot in robots:
        try:
            with Bench(robot) as bench:
                roles[robot] = roles_of(bench)
        except NotMoving as error:
            raise Problem(f"matrix: {robot} cannot be measured, because it does not move: {error}") from None
    return roles


def _kept(out: Path) -> Columns:
    """Return the columns (one per robot) of the page that an earlier run has written. New measurements replace
    those of the same robots.

    Raises:
        Problem: The page cannot be written. This is checked before hours of measuring.
    """
    path = out.with_suffix(".json")
    folder = out.absolute().parent
    if not folder.is_dir():
        raise Problem(f"matrix: the folder {folder} for the page does not exist. Make it")
    if out.is_dir() or not all(os.access(each if each.exists() else folder, os.W_OK) for each in (out, path)):
        raise Problem(f"matrix: {out} cannot be written. Give another path")
    if path == out:
        raise Problem(
            f"matrix: {out}: the page is Markdown, and a .json file beside it has the data. Give a path *.md"
        )
    try:
        return load(path)
    except msgspec.DecodeError as error:
        raise Problem(
            f"matrix: {path} is not the data of a matrix ({error}). Move it, or give another path"
        ) from None


class _Progress:
    """Prints a line about a cell (one robot with one fault) after its last trial, and after each unsafe trial."""

    def __init__(self, trials: Trials, repeats: int) -> None:
        self._trials = trials
        self._repeats = repeats

    def add(self, trial: Trial) -> None:
        self._trials.add(trial)
        robot, victim, fault = trial.cell
        cell = cell_named(victim, fault)
        row = summary(robot, cell, self._trials.of(robot, cell))
        if not trial.outcome.safe or row.trials == self._repeats:
            _tell(row)
        elif sys.stderr.isatty():
            print(f"{CLEAR}  {len(self._trials.all)}: {robot}, {cell}", end="", file=sys.stderr, flush=True)


def one_of_each() -> list[str]:
    """Return the first robot of each driver that can be simulated."""
    robots: dict[str, str] = {}
    for robot, driver in list_native_drivers().items():
        driver_class = get_native_driver_class(robot)
        if driver_class is not None and issubclass(driver_class, Driver) and driver_class.TWIN:
            robots.setdefault(driver, driver_class.SUPPORTED_ROBOTS[0])
    return sorted(robots.values())


def every_column() -> list[str]:
    """Return the robots of ``one_of_each``. If a robot can be commanded in several ways ("levels"), add the
    robot at each level."""
    robots = one_of_each()
    levels = (name for robot in robots for name in getattr(get_native_driver_class(robot), "LEVELS", ()))
    return sorted([*robots, *(name for name in levels if column(name)[0] in robots)])


def lowering_columns() -> list[str]:
    """Return the column of each arm that is lowered, of the robots of ``one_of_each``."""
    classes = {robot: get_native_driver_class(robot) for robot in one_of_each()}
    return [f"{robot}{LOWERING}" for robot, cls in classes.items() if end_of(robot, cls, lowered=True)]


def _chosen(text: str) -> list[str]:
    native_drivers = list_native_drivers()
    robots = [name.strip() for name in text.split(",") if name.strip()]
    for robot in robots:
        try:
            if column(robot)[0] not in native_drivers:
                raise Problem(f"matrix: no driver for {robot!r}. There are {', '.join(native_drivers)}")
        except ValueError as error:
            raise Problem(f"matrix: {error}") from None
    return robots


def _tell(row: Row) -> None:
    line = (
        f"{row.robot:<14} {row.victim:<16} {row.fault:<15} {row.safe_state:<6} "
        f"median {shown(row.median_ms):>7} ms  "
        f"worst {shown(row.worst_ms):>7} of {row.bound_ms:5.0f} ms  after {row.setpoints_after}  "
        f"disturbed {row.disturbed}  {verdict(row) if row.safe else verdict(row).upper()}"
    )
    print(f"{CLEAR if sys.stderr.isatty() else ''}{line}", file=sys.stderr, flush=True)
    for story in row.stories[-1:]:
        print(f"    the wire: {story}", file=sys.stderr, flush=True)
