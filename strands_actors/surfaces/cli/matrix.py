"""``matrix``: break each process and link of every robot with a twin, and report what the wires show."""

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
from strands_actors.testing.jobs import Cells, Plan, measure_all
from strands_actors.testing.matrix import Row, rows_of, shown, summary, verdict
from strands_actors.testing.matrix_page import INTRODUCTION, PAIRS, Columns, columns_of, encode, load, page
from strands_actors.testing.pairs import Pair, pairs_of
from strands_actors.testing.registering import column
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
    """Measure the kill matrix, and write the page. Return 1 if a cell is unsafe or past its bound, else 0.

    Args:
        drivers: Names of robots, with commas; None for one of each driver.
        repeats: Trials per cell.
        out: The page. The columns of other robots in it are kept. None prints it.
        json: Print JSON.
        jobs: Number of robots that are broken at the same time.
        resume: A file that keeps each trial. The trials in it are not repeated.
        pairs: Break two processes, one shortly after the other.
        victims: Measure only cells with one of these processes, with commas; None for all.

    Raises:
        Problem: An argument is wrong, or a cell cannot be measured. All other cells are written before.
    """
    robots = dict.fromkeys(_chosen(drivers) if drivers else every_column())
    kept = {} if out is None else _kept(out)
    roles = _roles_of(robots)
    of: Callable[[Driver, Iterable[str]], Iterable[Cell | Pair]] = pairs_of if pairs else cells_of
    cells: Cells = lambda robot, driver: of(driver, roles[robot])  # noqa: E731
    only = frozenset(name.strip() for name in (victims or "").split(",") if name.strip())
    known = {role for found in roles.values() for role in found} | set(Victims)
    if unknown := sorted(only - known):
        raise Problem(f"matrix: no process {', '.join(unknown)}. there are {', '.join(sorted(known))}")
    try:
        trials = Trials(resume, jobs)
    except testing_trials.Problem as problem:
        raise Problem(f"matrix: {problem}") from None
    problems = trio.run(
        measure_all, Plan(robots, repeats, trials, cells, only), jobs, _Progress(trials, repeats).heard
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
    """Return the processes of each robot. Each tree is run once for this."""
    found = {}
    for robot in robots:
        try:
            with Bench(robot) as bench:
                found[robot] = roles_of(bench)
        except NotMoving as why:
            raise Problem(f"matrix: {robot} does not move: {why}") from None
    return found


def _kept(out: Path) -> Columns:
    """Return the columns of the existing page. New measurements replace those of the same robots.

    Raises:
        Problem: The page cannot be written. This is checked before hours of measuring.
    """
    path = out.with_suffix(".json")
    folder = out.absolute().parent
    if not folder.is_dir():
        raise Problem(f"matrix: there is no folder {folder} for the page")
    if out.is_dir() or not all(os.access(each if each.exists() else folder, os.W_OK) for each in (out, path)):
        raise Problem(f"matrix: {out} cannot be written. name another page")
    if path == out:
        raise Problem(f"matrix: {out}: the page is Markdown, with its figures in a .json beside it. name it *.md")
    try:
        return load(path)
    except msgspec.DecodeError as error:
        raise Problem(
            f"matrix: {path} has no columns of a matrix ({error}). move it, or name another page"
        ) from None


class _Progress:
    """Prints a line for each cell that is complete or unsafe."""

    def __init__(self, trials: Trials, repeats: int) -> None:
        self._trials = trials
        self._repeats = repeats

    def heard(self, trial: Trial) -> None:
        self._trials.add(trial)
        robot, victim, fault = trial.cell
        cell = cell_named(victim, fault)
        row = summary(robot, cell, self._trials.of(robot, cell))
        if not trial.outcome.safe or row.trials == self._repeats:
            _tell(row)
        elif sys.stderr.isatty():
            print(f"{CLEAR}  {len(self._trials.all)}: {robot}, {cell}", end="", file=sys.stderr, flush=True)


def one_of_each() -> list[str]:
    """Return the first robot of each driver that has a twin."""
    found: dict[str, str] = {}
    for robot, driver in list_native_drivers().items():
        driver_class = get_native_driver_class(robot)
        if driver_class is not None and issubclass(driver_class, Driver) and driver_class.TWIN:
            found.setdefault(driver, driver_class.SUPPORTED_ROBOTS[0])
    return sorted(found.values())


def every_column() -> list[str]:
    """Return the robots of ``one_of_each``, and each of them at its other levels."""
    robots = one_of_each()
    levels = (name for robot in robots for name in getattr(get_native_driver_class(robot), "LEVELS", ()))
    return sorted([*robots, *(name for name in levels if column(name)[0] in robots)])


def _chosen(text: str) -> list[str]:
    known = list_native_drivers()
    robots = [name.strip() for name in text.split(",") if name.strip()]
    for robot in robots:
        try:
            if column(robot)[0] not in known:
                raise Problem(f"matrix: no driver for {robot!r}. there are {', '.join(known)}")
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
