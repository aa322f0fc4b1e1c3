"""The kill matrix: every victim with every fault on every robot that has a twin, measured and
written down.

A *bench* is a twin, a template and a caller. Callers are forked from the template, which has
imported everything and has one thread; each ends as a script does. *Jobs* are worker processes with
a bench each, given ten trials of one cell at a time; a robot of legs has one bench.

Benches disturb each other, which must neither be hidden nor taken for the robot's. A trial that is
safe but past its bound is *disturbed* when, between fault and safe frame, the processes of tree,
robot and bench together stood in line for a processor for more than 10 ms, and it would have kept
the bound without. It is repeated, and counted on the page. One that is not safe, or has setpoints
after, always counts. A cell of which more trials were disturbed than not is not called safe. A
trial begins only when the last that the wire showed before the fault is a setpoint.
"""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass

from strands_actors.contract.driver import Driver

from .bench import Bench, driver_of
from .cells import Outcome, run_cell, tries
from .faults import Cell, cells_of
from .jobs import Cells, Drivers
from .pairs import APART_S, Pair
from .queueing import DISTURBED_MS
from .trials import Trials


@dataclass(frozen=True)
class Row:
    """One cell of one robot. Times in milliseconds."""

    robot: str
    victim: str
    fault: str
    why_not: str = ""  # why it is not applicable; then the rest means nothing
    safe_state: str = ""
    trials: int = 0  # less the disturbed
    median_ms: float = 0.0
    worst_ms: float = 0.0
    bound_ms: float = 0.0
    setpoints_after: int = 0
    gone_worst_ms: float = 0.0
    late: int = 0  # trials past the bound
    unsafe: int = 0  # trials without a whole safe frame, or with a setpoint behind it
    disturbed: int = 0  # trials that were late because their processes stood in line for a processor
    proves: tuple[str, ...] = ()
    stories: tuple[str, ...] = ()  # of the trials that are not safe, or late

    @property
    def excused(self) -> bool:
        """More often than not: that is no longer the machine."""
        return self.disturbed > self.trials

    @property
    def safe(self) -> bool:
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
    """Each cell of one robot, in the order of the tables."""
    with Bench(robot, driver_class) as bench:
        for cell in cells_of(bench.driver):
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


def rows_of(drivers: Drivers, trials: Trials, cells: Cells = cells_of) -> Iterator[Row]:
    """Each cell of each robot, in the order of the tables."""
    for robot, driver_class in drivers.items():
        for cell in cells(driver_of(robot, driver_class)):
            yield summary(robot, cell, () if cell.why_not else trials.of(robot, cell))


def summary(robot: str, cell: Cell | Pair, outcomes: Sequence[Outcome]) -> Row:
    """Figures are of the trials that were not disturbed; of what is not safe none is left out."""
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
        round(statistics.median(times), 1),
        round(times[-1], 1),
        round(counted[0].bound_ms),
        sum(max(0, outcome.setpoints_after) for outcome in outcomes),
        round(max(outcome.gone_ms for outcome in counted), 1),
        sum(outcome.late for outcome in counted),
        sum(not outcome.safe for outcome in outcomes),
        len(outcomes) - len(counted),
        cell.proves,
        tuple(outcome.story for outcome in counted if not outcome.safe or outcome.late),
    )


# -- written down


def conditions(trials: Trials) -> dict[str, str]:
    """Under which figures were taken."""
    loads = [trial.load for trial in trials.all] or [0.0]
    dates = [trial.at for trial in trials.all] or [trials.runs[-1].at]
    jobs = sorted({run.jobs for run in trials.runs})
    again = {
        f"measured again from {run.at} on": f"{', '.join(run.again)}. {run.why} {run.subject['strands-actors']}"
        for run in trials.runs
        if run.again
    }
    disturbed = sum(trial.outcome.disturbed for trial in trials.all)
    return {
        "date": f"{dates[0]} to {dates[-1]} UTC",
        **trials.runs[0].subject,
        "load": f"{min(loads):.1f} to {max(loads):.1f} (last minute, at each trial)",
        "jobs": f"{' or '.join(map(str, jobs))} side by side",
        "trials": f"{len(trials.all)}, of which disturbed: {disturbed}",
        **again,
    }


def as_json(rows: Sequence[Row], taken: dict[str, str]) -> str:
    cells = [{**asdict(row), "safe": None if row.why_not else row.safe} for row in rows]
    for cell in cells:  # JSON has no infinity
        cell.update({key: None for key in ("median_ms", "worst_ms") if math.isinf(cell[key])})
    return json.dumps({"conditions": taken, "safe": all(row.safe for row in rows), "cells": cells})


INTRODUCTION = """\
# Kill matrix

Each cell: one victim of a moving robot is broken in one way, and the time to the safe frame is read from the log
of the robot's end of the wire, not from the program. This page was made by
`strands-actors matrix --repeats {repeats} -o docs/kill-matrix.md`.

* **median / worst**: milliseconds from the fault to the frame that brings the whole robot to its safe state. Of
  a caller that ends by itself: from its end. Of a frozen robot or a pulled cable: from its return. Of the other
  faults of the robot: from a stop that is given while the fault lasts.
* **after**: setpoints behind that frame, over all trials. Anything but 0 is a defect; so is a time past the bound.
  * **disturbed**: trials that were repeated, because the machine and not the robot made them late: safe, past
    the bound, but the processes of tree, robot and bench stood in line for a processor (Linux counts that) for
    more than {disturbed_ms:g} ms between fault and safe frame, and without that would have kept the bound; or
    safe on another safe state, because a process that got no processor looked frozen before the fault did. A
    trial that is not safe is always counted, and a cell of which more trials were disturbed than not is not
    called safe. Benches run side by side (`jobs`) and disturb each other.
* Each caller is a process of its own session, forked from one that has imported everything; root, wire and policy
  processes are started as they always are.
* **proves**: requirements of [safety.md](safety.md).
"""


PAIRS = """\
# Kill matrix of pairs

Each cell: two processes of a moving robot are broken, one within {apart_ms:g} ms of the other, in a drawn order,
and the time to the safe frame is read from the log of the robot's end of the wire, not from the program. This page
was made by `strands-actors matrix --pairs --repeats {repeats} -o docs/kill-matrix-pairs.md`.

* **kill**: SIGKILL; **freeze**: SIGSTOP, and SIGCONT at the end. Of `freeze + kill` the first victim is frozen.
* **median / worst**: milliseconds from the *later* of the two faults to the frame that brings the whole robot to
  its safe state; 0 when it was there before the second one broke.
* **bound**: of root and wire together the standby's: after two kills the driver's own, else
  the time after which both count as silent, and one look, before it. Of all others the longer of the two alone
  ([safety.md](safety.md)).
* **after**: setpoints behind that frame, over all trials. Anything but 0 is a defect; so is a time past the bound.
* **disturbed**: as in [kill-matrix.md](kill-matrix.md): repeated, since the processes stood in line for a processor
  for more than {disturbed_ms:g} ms.
* **pkill python** reaches the script alone: the processes of the tree have names of their own.
  `pkill -9 -f strands` reaches them all at once. Nobody is left to write, so there is no row for it: what happens
  then is the firmware's doing (`firmware_watchdog` in the status of each robot, and [safety.md](safety.md)).
"""


def page(rows: Sequence[Row], taken: dict[str, str], introduction: str = INTRODUCTION) -> str:
    """The page as Markdown."""
    repeats = max((row.trials for row in rows), default=1)
    lines = [introduction.format(repeats=repeats, disturbed_ms=DISTURBED_MS, apart_ms=APART_S * 1e3)]
    lines += ["| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in taken.items()), ""]
    measured = [row for row in rows if not row.why_not]
    bad = [row for row in measured if not row.safe]
    verdict = "every one safe and within its bound" if not bad else f"**{len(bad)} not safe, or past their bound**"
    trials = sum(row.trials for row in measured)
    after = sum(row.setpoints_after for row in measured)
    fewest = min((row.trials for row in measured), default=0)
    made = f"{len(measured)} cells, {trials} trials, at least {fewest} a cell"
    lines += [f"{made}, {after} setpoints after a safe frame: {verdict}.", ""]
    for robot in dict.fromkeys(row.robot for row in rows):
        lines += [f"## {robot}", "", *_table([row for row in rows if row.robot == robot]), ""]
    return "\n".join(lines)


def _table(rows: Sequence[Row]) -> Iterator[str]:
    yield "| victim | fault | safe state | median | worst | bound | after | trials | disturbed | proves |"
    yield "|---|---|---|---:|---:|---:|---:|---:|---:|---|"
    for row in rows:
        if row.why_not:
            continue
        mark = "" if row.safe else f" **{verdict(row)}**"
        yield (
            f"| {row.victim} | {row.fault} | {row.safe_state} | {row.median_ms:.1f} | {row.worst_ms:.1f}{mark} "
            f"| {row.bound_ms:.0f} | {row.setpoints_after} | {row.trials} | {row.disturbed} "
            f"| {', '.join(row.proves)} |"
        )
    for row in rows:
        for story in row.stories:
            yield ""
            yield f"{row.victim} {row.fault}, {verdict(row)}: from the fault on the wire showed {story}."
    yield ""
    yield "Not applicable:"
    yield ""
    for victim in dict.fromkeys(row.victim for row in rows):
        for why in dict.fromkeys(row.why_not for row in rows if row.victim == victim and row.why_not):
            faults = dict.fromkeys(row.fault for row in rows if _is(row, victim, row.fault, why))
            yield f"* {victim}: {', '.join(faults)}: {why}."


def verdict(row: Row) -> str:
    if row.safe:
        return "safe"
    if row.unsafe:
        return "not safe"
    if row.late:
        return "late"
    return "mostly disturbed" if row.trials else "not measured"


def _is(row: Row, victim: str, fault: str, why: str) -> bool:
    return row.victim == victim and row.fault == fault and row.why_not == why
