"""``matrix``: break what there is to break, on every robot with a twin, and write down what the wires show."""

from __future__ import annotations

import sys
from pathlib import Path

from ..drivers import get_native_driver_class, list_native_drivers
from ..runtime.contract import Driver
from ..testing.bench import NotMoving
from ..testing.faults import Cell
from ..testing.matrix import Row, as_json, conditions, measure, page
from .errors import Problem

CLEAR = "\r\x1b[K"


def run(drivers: str | None, repeats: int, out: Path | None, json: bool) -> int:
    """1 when a cell is unsafe or past its bound. A robot that cannot be measured does not take the others' rows
    with it: they are written, and then it is a problem."""
    robots = _chosen(drivers) if drivers else one_of_each()
    taken, rows = conditions(), list[Row]()
    problem: Problem | None = None
    for robot in robots:
        try:
            for row in measure(robot, repeats, progress=_progress):
                rows.append(row)
                _tell(row)
        except (NotMoving, RuntimeError, TimeoutError) as failure:
            problem = problem or Problem(f"matrix: {failure}")
    if out is not None:
        out.write_text(page(rows, taken))
    if json:
        print(as_json(rows, taken))
    elif out is None:
        print(page(rows, taken))
    if problem is not None:
        raise problem
    return 0 if all(row.safe for row in rows) else 1


def one_of_each() -> list[str]:
    """The first robot of each driver that has a twin."""
    found: dict[str, str] = {}
    for robot, driver in list_native_drivers().items():
        driver_class = get_native_driver_class(robot)
        if driver_class is not None and issubclass(driver_class, Driver) and driver_class.TWIN:
            found.setdefault(driver, driver_class.SUPPORTED_ROBOTS[0])
    return sorted(found.values())


def _chosen(text: str) -> list[str]:
    known = list_native_drivers()
    robots = [name.strip() for name in text.split(",") if name.strip()]
    for robot in robots:
        if robot not in known:
            raise Problem(f"matrix: no driver for {robot!r}. there are {', '.join(known)}")
    return robots


def _progress(robot: str, cell: Cell, trial: int) -> None:
    if sys.stderr.isatty():
        print(f"{CLEAR}  {robot}: {cell}, trial {trial + 1}", end="", file=sys.stderr, flush=True)


def _tell(row: Row) -> None:
    if row.why_not:
        return
    verdict = "safe" if row.safe else "NOT SAFE" if row.unsafe else "LATE"
    line = (
        f"{row.robot:<14} {row.victim:<7} {row.fault:<13} {row.rung:<6} median {row.median_ms:7.1f} ms  "
        f"worst {row.worst_ms:7.1f} of {row.bound_ms:5.0f} ms  after {row.setpoints_after}  {verdict}"
    )
    print(f"{CLEAR if sys.stderr.isatty() else ''}{line}", file=sys.stderr, flush=True)
