"""Write a kill matrix as a page for people, and the same figures as JSON.

A *column* has all measurements of one robot in one run, with the conditions of the run. The JSON file contains the
columns. So one robot can be measured again, and only its column is replaced.
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
    """The results of all cells (victim, fault) of one robot, and the conditions of the measurement."""

    conditions: dict[str, str] = msgspec.field(name="taken")
    rows: list[Row]


Columns = dict[str, Column]
"""The column of each robot."""


def columns_of(rows: Iterable[Row], trials: Trials) -> Columns:
    """Return the columns (one for each robot) of new measurements."""
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
    dates = [trial.time_utc for trial in measured] or [trials.runs[-1].time_utc]
    jobs = sorted({run.jobs for run in trials.runs})
    disturbed = sum(trial.outcome.disturbed for trial in measured)
    return {
        "date": f"{dates[0]} to {dates[-1]} UTC",
        **trials.runs[-1].subject,
        "load": f"{min(loads):.1f} to {max(loads):.1f}",
        "jobs": f"{' or '.join(map(str, jobs))} at a time",
        "trials": f"{len(measured)}, of which disturbed: {disturbed}",
    }


# -- as JSON


def load(path: Path) -> Columns:
    """Read the columns (the measurements of each robot) from a JSON file.

    Return no columns if there is no file. Raise ``msgspec.DecodeError`` for wrong content.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=Columns)
    except FileNotFoundError:
        return {}


def encode(columns: Mapping[str, Column]) -> bytes:
    """Return the columns (the measurements of each robot) as JSON, with a line for each cell."""
    return b"{" + b",\n".join(_column(robot, column) for robot, column in columns.items()) + b"}\n"


def _column(robot: str, column: Column) -> bytes:
    rows = b",\n".join(msgspec.json.encode(row) for row in column.rows)
    return b'%b: {"taken": %b, "rows": [\n%b\n]}' % (
        msgspec.json.encode(robot),
        msgspec.json.encode(column.conditions),
        rows,
    )


# -- the Markdown page


INTRODUCTION = """\
# Kill matrix

In each cell of this matrix, one process of a moving simulated robot, or the robot itself, is broken
in one way. The time until the robot gets the frame of its safe state is read from the log of the
simulated robot, not from the program. The command `strands-actors matrix --repeats {repeats} --jobs
2 -o docs/kill-matrix.md` made this page. With `--drivers ROBOT` the command measures only this robot
and replaces its table. [testing.md](testing.md#break-things-victims--faults) explains the names of
the faults.

* **victim**: the process that is broken, or the simulated robot itself (`twin`). Each process that
  `strands-actors tree` shows for a running robot is a victim.
* **median / worst**: milliseconds from the fault to the frame that brings the whole robot to its
  safe state. In three cases the measured time begins later than the fault:
  * If the caller (the script) ends by itself, the time begins when its process has ended.
  * If the robot is frozen or its cable is unplugged, the time begins when the robot continues or
    the cable is plugged in again. A time of 0 means that the safe frame was written while the robot
    was frozen, and no other frame followed.
  * For the other faults of the robot, the time begins with a stop that is ordered during the fault.
    A time of 0 means that the fault itself had already led to the safe state before the stop.
* **after**: number of setpoints that followed the frame of the safe state, in all trials. Any such
  setpoint is a defect, and so is a time above the bound.
* **disturbed**: number of trials that were repeated because the computer was too busy. A trial
  counts as disturbed in two cases. In the first case the robot became safe after the bound, but its
  processes had waited for a processor for more than {disturbed_ms:g} ms (as Linux counts it), and
  without this waiting time the bound is kept. In the second case the robot went to another safe
  state than expected, because a process that got no processor looked frozen before the fault. A
  trial in which the robot is not safe is never repeated. A cell with more disturbed than
  undisturbed trials does not count as safe. Robots that are measured at the same time (`jobs` in
  the measuring conditions) disturb each other.
* Each trial that breaks the caller starts a new caller, forked from a process with all imports.
  Root, wire and policy processes start as usual.
* If the end of a victim has no effect on the wire (standby, spawner, camera, recorder, stop
  process), the robot must continue for half a second. After this half second a stop is ordered, and
  the time of the cell counts from this stop.
* A column **`robot:lowering`** is of an arm that is [laid down, then limp](lowering.md). The victim
  breaks at a random time in the first 1.2 s of a lowering. The time of its cells goes to the frame
  that switches the torque off. If the wire or the root process breaks, that is the time until
  another process does it. If another process breaks, the arm goes on down. All other columns of
  such arms are measured with `on_exit="limp"`.
* A column **`robot:gripper=NAME`** is of an arm that carries this gripper. Arm and gripper share
  their processes, and both move in each trial. A setpoint of either after the stop counts.
* **proves**: the ids of the requirements in [safety-evidence.md](safety-evidence.md#requirements)
  that the trials of the cell prove.
"""


PAIRS = """\
# Kill matrix of pairs

In each cell of this matrix, two processes of a moving simulated robot are broken, within
{apart_ms:g} ms and in random order. The time until the robot gets the frame of its safe state is
read from the log of the simulated robot, not from the program. The command `strands-actors matrix
--pairs --repeats {repeats} --jobs 2 -o docs/kill-matrix-pairs.md` made this page.

* **kill** means that the process gets SIGKILL. **freeze** means that the process gets SIGSTOP, and
  SIGCONT at the end of the trial. In `freeze + kill` the first victim is frozen and the second is
  killed.
* **median / worst**: milliseconds from the *later* of the two faults to the frame that brings the
  whole robot to its safe state. A time of 0 means that the robot was in its safe state before the
  second fault.
* **bound**: if root and wire process are the two victims, the standby process stops the robot. If
  both were killed, the bound is that of the driver. If one or both were frozen, the time until both
  count as silent, and one tick of the standby, are added. For all other pairs, the bound is the
  longer one of the two bounds that the victims have alone
  ([safety-faults.md](safety-faults.md#bounds-of-two-at-once)).
* **victim**: all pairs of processes that the running robot has. If the two faults have no effect on
  the connection to the robot, a stop is ordered after them, and the time of the cell counts from
  this stop.
* **after**: number of setpoints that followed the frame of the safe state, in all trials. Any such
  setpoint is a defect, and so is a time above the bound.
* **disturbed**: number of trials that were repeated, because their processes had waited for a
  processor for more than {disturbed_ms:g} ms ([kill-matrix.md](kill-matrix.md) describes the rule).
* **pkill python** ends only the script, because the other processes of the robot have other names.
  `pkill -9 -f strands` is not measured, because it kills all processes at once, so that no process
  is left that could write to the robot, and only the firmware acts (`firmware_watchdog` in the
  status of each robot, and [safety-faults.md](safety-faults.md#firmware)).
"""


def page(columns: Mapping[str, Column], introduction: str = INTRODUCTION) -> str:
    """Return the page of a kill matrix as Markdown."""
    rows = [row for column in columns.values() for row in column.rows]
    measured = [row for row in rows if not row.why_not]
    repeats = max((row.trials for row in measured), default=1)
    bad = [row for row in measured if not row.safe]
    judged = "every cell safe and within its bound" if not bad else f"**{len(bad)} not safe, or past their bound**"
    trials = sum(row.trials for row in measured)
    after = sum(row.setpoints_after for row in measured)
    fewest = min((row.trials for row in measured), default=0)
    made = f"{len(columns)} robots, {len(measured)} cells, {trials} trials, at least {fewest} in each cell"
    lines = [introduction.format(repeats=repeats, disturbed_ms=DISTURBED_MS, apart_ms=APART_S * 1e3)]
    lines += [paragraph(f"{made}, {after} setpoints after a safe frame: {judged}."), ""]
    for robot, column in columns.items():
        text = "; ".join(f"{key}: {value}" for key, value in column.conditions.items())
        lines += [f"## {robot}", "", paragraph(f"*Measuring conditions: {text}.*"), "", *_table(column.rows), ""]
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
    faults: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row.why_not:
            faults.setdefault((row.victim, row.why_not), []).append(row.fault)
    if faults:
        yield ""
        yield "These faults were not tested:"
        yield ""
    for (victim, reason), of_them in faults.items():
        yield paragraph(f"* {victim} was not tested with {', '.join(of_them)}. Reason: {reason}.", "  ")
