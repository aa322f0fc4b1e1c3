"""Write a kill matrix as a page for people, and the same figures as JSON.

A *column* has all measurements of one robot in one run, with the conditions. The JSON file keeps the columns,
so that one robot can be measured again and its column replaced.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import msgspec

from .markdown import paragraph
from .matrix import Row, shown, verdict
from .pairs import APART_S
from .queueing import DISTURBED_MS
from .trials import Trials


class Column(msgspec.Struct, frozen=True):
    """The cells of one robot, and the conditions under which they were measured."""

    taken: dict[str, str]
    rows: list[Row]


Columns = dict[str, Column]
"""The column of each robot."""


def columns_of(rows: Iterable[Row], trials: Trials) -> Columns:
    """Return the columns of new measurements."""
    columns: Columns = {}
    for row in rows:
        if row.robot not in columns:
            columns[row.robot] = Column(conditions(trials, row.robot), [])
        columns[row.robot].rows.append(row)
    return columns


def conditions(trials: Trials, robot: str) -> dict[str, str]:
    """Return the conditions under which the figures of a robot were measured."""
    measured = [trial for trial in trials.all if trial.robot == robot]
    loads = [trial.load for trial in measured] or [0.0]
    dates = [trial.at for trial in measured] or [trials.runs[-1].at]
    jobs = sorted({run.jobs for run in trials.runs})
    disturbed = sum(trial.outcome.disturbed for trial in measured)
    return {
        "date": f"{dates[0]} to {dates[-1]} UTC",
        **trials.runs[-1].subject,
        "load": f"{min(loads):.1f} to {max(loads):.1f}",
        "jobs": f"{' or '.join(map(str, jobs))} side by side",
        "trials": f"{len(measured)}, of which disturbed: {disturbed}",
    }


# -- as JSON


def load(path: Path) -> Columns:
    """Read the columns of a file. Return nothing if there is no file. Raise ``msgspec.DecodeError``."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=Columns)
    except FileNotFoundError:
        return {}


def encode(columns: Mapping[str, Column]) -> bytes:
    """Return the columns as JSON, with a line for each cell."""
    return b"{" + b",\n".join(_column(robot, column) for robot, column in columns.items()) + b"}\n"


def _column(robot: str, column: Column) -> bytes:
    rows = b",\n".join(msgspec.json.encode(row) for row in column.rows)
    return b'%b: {"taken": %b, "rows": [\n%b\n]}' % (
        msgspec.json.encode(robot),
        msgspec.json.encode(column.taken),
        rows,
    )


# -- as a page


INTRODUCTION = """\
# Kill matrix

In each cell one process of a moving robot, or the robot itself, is broken in one way. The time to the
safe frame is read from the twin's wire log, not from the program. The command
`strands-actors matrix --repeats {repeats} --jobs 2 -o docs/kill-matrix.md` made this page. With
`--drivers ROBOT` it replaces the column of that robot.

* **median / worst**: milliseconds from the fault to the frame that brings the whole robot to its
  safe state. The time begins
  * for a caller that ends by itself: at its end;
  * for a frozen robot or a pulled cable: at its return. 0 means that the safe frame was written
    during the freeze, and no other frame followed;
  * for the other faults of the robot: at a stop that is given during the fault. 0 means that the
    fault itself had already led to the safe state.
* **after**: setpoints behind that frame, over all trials. Any value above 0 is a defect, and so is a
  time past the bound.
* **disturbed**: repeated trials, which the machine made late and not the robot. Such a trial was
  safe but past the bound. Its processes (tree, robot, bench) waited for a processor for more than
  {disturbed_ms:g} ms between fault and safe frame, by Linux' own count, and kept the bound without
  that time. Or it was safe in another safe state, because a process without a processor looked
  frozen before the fault. A trial that is not safe always counts. A cell with more disturbed than
  undisturbed trials does not count as safe. Parallel benches (`jobs`) disturb each other.
* Each caller has a separate session and is forked from a process with all imports. Root, wire and
  policy processes start as usual.
* **Victims** are the roles of the running tree. If the wire shows nothing of a victim's end (standby,
  spawner, camera, recorder, stop process), the robot must go on for half a second. Then it is
  stopped, and time counts from that stop.
* **proves**: requirements of [safety-evidence.md](safety-evidence.md#requirements).
"""


PAIRS = """\
# Kill matrix of pairs

In each cell two processes of a moving robot are broken within {apart_ms:g} ms, in random order. The
time to the safe frame is read from the twin's wire log, not from the program. The command
`strands-actors matrix --pairs --repeats {repeats} --jobs 2 -o docs/kill-matrix-pairs.md` made this
page.

* **kill**: SIGKILL; **freeze**: SIGSTOP, and SIGCONT at the end. In `freeze + kill` the first
  victim is frozen.
* **median / worst**: milliseconds from the *later* of the two faults to the frame that brings the
  whole robot to its safe state. 0 means that it was there before the second fault.
* **bound**: for root and wire together that of the standby: the driver's bound after two kills,
  otherwise also the time until both count as silent, and one tick. For all others the longer one of
  the two alone ([safety-faults.md](safety-faults.md#bounds-of-two-at-once)).
* **Victims** are all pairs of roles of the running tree. If the wire shows nothing of both faults, a
  stop follows, and time counts from it.
* **after**: setpoints behind that frame, over all trials. Any value above 0 is a defect, and so is a
  time past the bound.
* **disturbed**: repeated trials, as in [kill-matrix.md](kill-matrix.md): their processes waited for a
  processor for more than {disturbed_ms:g} ms.
* **pkill python** reaches only the script, because the processes of the tree have other names.
  `pkill -9 -f strands` reaches all at once and has no row: no process is left to write, and the
  firmware decides (`firmware_watchdog` in the status of each robot, and
  [safety-faults.md](safety-faults.md#firmware)).
"""


def page(columns: Mapping[str, Column], introduction: str = INTRODUCTION) -> str:
    """Return the page as Markdown."""
    rows = [row for column in columns.values() for row in column.rows]
    measured = [row for row in rows if not row.why_not]
    repeats = max((row.trials for row in measured), default=1)
    bad = [row for row in measured if not row.safe]
    judged = "every one safe and within its bound" if not bad else f"**{len(bad)} not safe, or past their bound**"
    trials = sum(row.trials for row in measured)
    after = sum(row.setpoints_after for row in measured)
    fewest = min((row.trials for row in measured), default=0)
    made = f"{len(columns)} robots, {len(measured)} cells, {trials} trials, at least {fewest} a cell"
    lines = [introduction.format(repeats=repeats, disturbed_ms=DISTURBED_MS, apart_ms=APART_S * 1e3)]
    lines += [paragraph(f"{made}, {after} setpoints after a safe frame: {judged}."), ""]
    for robot, column in columns.items():
        taken = "; ".join(f"{key}: {value}" for key, value in column.taken.items())
        lines += [f"## {robot}", "", paragraph(f"*{taken}.*"), "", *_table(column.rows), ""]
    return "\n".join(lines)


def _table(rows: Sequence[Row]) -> Iterator[str]:
    yield "| victim | fault | safe state | median | worst | bound | after | trials | disturbed | proves |"
    yield "|---|---|---|---:|---:|---:|---:|---:|---:|---|"
    for row in rows:
        if row.why_not:
            continue
        mark = "" if row.safe else f" **{verdict(row)}**"
        yield (
            f"| {row.victim} | {row.fault} | {row.safe_state} "
            f"| {shown(row.median_ms)} | {shown(row.worst_ms)}{mark} "
            f"| {row.bound_ms:.0f} | {row.setpoints_after} | {row.trials} | {row.disturbed} "
            f"| {', '.join(row.proves)} |"
        )
    for row in rows:
        for story in row.stories:
            yield ""
            yield paragraph(f"{row.victim} {row.fault}, {verdict(row)}: from the fault on the wire showed {story}.")
    yield ""
    yield "Not applicable:"
    yield ""
    faults: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row.why_not:
            faults.setdefault((row.victim, row.why_not), []).append(row.fault)
    for (victim, why), of_them in faults.items():
        yield paragraph(f"* {victim}: {', '.join(of_them)}: {why}.", "  ")
