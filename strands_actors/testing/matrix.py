"""The kill matrix: every victim with every fault on every robot that has a twin, measured and written down."""

from __future__ import annotations

import json
import os
import platform
import statistics
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from strands_actors import __version__
from strands_actors.runtime.contract import Driver

from .bench import Bench, NotMoving
from .cells import Outcome, run_cell
from .faults import Cell, Faults, Victims, cells_of


@dataclass(frozen=True)
class Row:
    """One cell of one robot. Times in milliseconds."""

    robot: str
    victim: str
    fault: str
    why_not: str = ""  # why it is not applicable; then the rest means nothing
    rung: str = ""
    trials: int = 0
    median_ms: float = 0.0
    worst_ms: float = 0.0
    bound_ms: float = 0.0
    setpoints_after: int = 0
    gone_worst_ms: float = 0.0
    late: int = 0  # trials past the bound
    unsafe: int = 0  # trials without a whole safe frame, or with a setpoint behind it
    proves: tuple[str, ...] = ()

    @property
    def safe(self) -> bool:
        return not self.unsafe and not self.late


Progress = Callable[[str, Cell, int], None]
"""(robot, cell, trial)"""


def measure(
    robot: str,
    repeats: int = 1,
    driver_class: type[Driver] | None = None,
    only: Callable[[Cell], bool] = lambda _: True,
    progress: Progress = lambda *_: None,
) -> Iterator[Row]:
    """Each cell of one robot, in the order of the tables."""
    with Bench(robot, driver_class) as bench:
        for cell in cells_of(bench.driver):
            if not only(cell):
                continue
            if cell.why_not:
                yield Row(robot, cell.victim, cell.fault, cell.why_not)
                continue
            outcomes = []
            for trial in range(repeats):
                progress(robot, cell, trial)
                outcomes.append(_try(cell, bench))
            yield summary(robot, cell, outcomes)


def _try(cell: Cell, bench: Bench) -> Outcome:
    try:
        return run_cell(cell, bench)
    except NotMoving as why:
        raise NotMoving(f"{bench.robot}, {cell}: {why}") from why


def summary(robot: str, cell: Cell, outcomes: Sequence[Outcome]) -> Row:
    times = sorted(outcome.safe_ms for outcome in outcomes)
    return Row(
        robot,
        cell.victim,
        cell.fault,
        "",
        outcomes[0].rung,
        len(outcomes),
        round(statistics.median(times), 1),
        round(times[-1], 1),
        round(outcomes[0].bound_ms),
        sum(max(0, outcome.setpoints_after) for outcome in outcomes),
        round(max(outcome.gone_ms for outcome in outcomes), 1),
        sum(outcome.safe_ms > outcome.bound_ms for outcome in outcomes),
        sum(not outcome.safe for outcome in outcomes),
        cell.proves,
    )


# -- written down


def conditions() -> dict[str, str]:
    """Under which figures were taken."""
    load = ", ".join(f"{value:.2f}" for value in os.getloadavg())
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machine": f"{_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.release()}",
        "load": f"{load} (1, 5, 15 min)",
        "python": sys.version.split()[0],
        "strands-actors": __version__,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def as_json(rows: Sequence[Row], taken: dict[str, str]) -> str:
    cells = [{**asdict(row), "safe": row.safe if not row.why_not else None} for row in rows]
    return json.dumps({"conditions": taken, "safe": all(row.safe for row in rows), "cells": cells})


INTRODUCTION = """\
# Kill matrix

Each cell: one victim of a moving robot is broken in one way, and the time to the safe frame is read from the log
of the robot's end of the wire, not from the program. This page was made by
`strands-actors matrix --repeats {repeats} -o docs/kill-matrix.md`.

* **median / worst**: milliseconds from the fault to the frame that brings the whole robot to its rung. Of a caller
  that ends by itself: from its end. Of a frozen robot or a pulled cable: from its return. Of the other faults of
  the robot: from a stop that is given while the fault lasts.
* **after**: setpoints behind that frame, over all trials. Anything but 0 is a defect; so is a time past the bound.
* **proves**: requirements of [safety.md](safety.md).
"""


def page(rows: Sequence[Row], taken: dict[str, str]) -> str:
    """The page as Markdown."""
    lines = [INTRODUCTION.format(repeats=max((row.trials for row in rows), default=1))]
    lines += ["| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in taken.items()), ""]
    measured = [row for row in rows if not row.why_not]
    bad = [row for row in measured if not row.safe]
    verdict = "every one safe and within its bound" if not bad else f"**{len(bad)} not safe, or past their bound**"
    trials = sum(row.trials for row in measured)
    after = sum(row.setpoints_after for row in measured)
    lines += [f"{len(measured)} cells, {trials} trials, {after} setpoints after a safe frame: {verdict}.", ""]
    for robot in dict.fromkeys(row.robot for row in rows):
        lines += [f"## {robot}", "", *_table([row for row in rows if row.robot == robot]), ""]
    return "\n".join(lines)


def _table(rows: Sequence[Row]) -> Iterator[str]:
    yield "| victim | fault | rung | median | worst | bound | after | trials | proves |"
    yield "|---|---|---|---:|---:|---:|---:|---:|---|"
    for row in rows:
        if row.why_not:
            continue
        mark = "" if row.safe else " **not safe**" if row.unsafe else " **late**"
        yield (
            f"| {row.victim} | {row.fault} | {row.rung} | {row.median_ms:.1f} | {row.worst_ms:.1f}{mark} "
            f"| {row.bound_ms:.0f} | {row.setpoints_after} | {row.trials} | {', '.join(row.proves)} |"
        )
    yield ""
    yield "Not applicable:"
    yield ""
    for victim in Victims:
        for why in dict.fromkeys(row.why_not for row in rows if row.victim == victim and row.why_not):
            faults = [fault for fault in Faults if any(_is(row, victim, fault, why) for row in rows)]
            yield f"* {victim}: {', '.join(faults)}: {why}."


def _is(row: Row, victim: str, fault: str, why: str) -> bool:
    return row.victim == victim and row.fault == fault and row.why_not == why
