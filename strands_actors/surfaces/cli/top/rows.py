"""Build the line of each robot, and the table about the selected robot, from their states."""

from __future__ import annotations

from collections import deque

from rich.table import Table
from rich.text import Text

from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.supervisors.gate.messages import StopReport
from strands_actors.surfaces.cli.trees import styled

from .feed import RobotSnapshot

WINDOW_S = 2.0
"""Rates are means over this time, in seconds. Over shorter times they would flicker."""
LATE_S, GONE_S = 0.3, 1.0
"""Ages of an observation, in seconds: above the first it is yellow, above the second red."""

Columns = tuple[tuple[str, int], ...]
"""Title and width of each column."""

COLUMNS: Columns = (
    ("robot", 17),
    ("state", 12),
    ("epoch", 5),
    ("lease", 0),
    ("writes/s", 8),
    ("reads/s", 8),
    ("age", 8),
    ("restarts", 8),
    ("refused", 7),
)
LEASE = (12, 40)
"""Least and greatest width of the lease's column. It takes the width that the others leave."""
SPARED = ("lease", "refused", "restarts", "epoch")
"""Columns that a narrow screen leaves out, in this order."""
PADDING = 2
"""Padding of every cell, both sides together."""
RIGHT = frozenset({"epoch", "writes/s", "reads/s", "age", "restarts", "refused"})
NOTHING = Text("–", "dim")


def columns_for(width: int) -> Columns:
    """Return the columns that fit into a screen of this width, in characters."""
    titles = [title for title, _ in COLUMNS]
    for spared in ("", *SPARED):
        titles = [title for title in titles if title != spared]
        fixed = sum(size + PADDING for title, size in COLUMNS if title in titles)
        lease_width = width - fixed
        if lease_width >= (LEASE[0] if "lease" in titles else 0):
            break
    return tuple(
        (title, min(lease_width, LEASE[1]) if title == "lease" else size)
        for title, size in COLUMNS
        if title in titles
    )


class Rates:
    """Writes to one robot and readings of it, per second, computed from the counters in the robot's status."""

    def __init__(self) -> None:
        self._counts: deque[tuple[float, int, int]] = deque()

    def add(self, snapshot: RobotSnapshot) -> None:
        status = snapshot.status
        if status is None:
            self._counts.clear()
            return
        if self._counts and (status.writes < self._counts[-1][1] or status.reads < self._counts[-1][2]):
            self._counts.clear()  # The wire process was replaced, and the new process counts from zero.
        self._counts.append((snapshot.at_s, status.writes, status.reads))
        while snapshot.at_s - self._counts[0][0] > WINDOW_S:
            self._counts.popleft()

    @property
    def per_s(self) -> tuple[float, float] | None:
        """Writes to the robot and readings of it, per second. None until the robot was sampled twice."""
        if len(self._counts) < 2:
            return None
        (began_s, *before), (ended_s, *after) = self._counts[0], self._counts[-1]
        writes, reads = ((now - then) / (ended_s - began_s) for then, now in zip(before, after, strict=True))
        return writes, reads


def row(snapshot: RobotSnapshot, rates: Rates, columns: Columns) -> list[Text]:
    """Return the line of a robot, with one cell per column."""
    status = snapshot.status
    per_s = rates.per_s
    restarts = sum(process.restarts for process in snapshot.tree.processes)
    cells = {
        "robot": Text(snapshot.note.robot, "bold"),
        "state": state(snapshot),
        "epoch": Text(str(snapshot.tree.epoch)) if snapshot.tree.epoch else NOTHING,
        "lease": Text(holder(status.holder)) if status and status.holder else NOTHING,
        "writes/s": NOTHING if per_s is None else Text(f"{per_s[0]:.0f}"),
        "reads/s": NOTHING if per_s is None else Text(f"{per_s[1]:.0f}"),
        "age": NOTHING if status is None else age(status.age_s),
        "restarts": Text(str(restarts), "yellow" if restarts else "dim"),
        "refused": NOTHING if status is None else Text(str(status.refusals), "" if status.refusals else "dim"),
    }
    return [_set(cells[title], title, width) for title, width in columns]


def state(snapshot: RobotSnapshot) -> Text:
    """Return the text for the robot's mode, such as e-stopped. If the wire process (which communicates with the
    robot) answers, the mode in its status is used, which is newer than the mode in the report of the root
    process."""
    if snapshot.status is None:
        return styled(snapshot.tree.state)
    if snapshot.status.locked_by and snapshot.status.mode == Mode.DISARMED:
        return Text("e-stopped", "bold magenta")
    return styled(snapshot.status.mode)


def holder(name: str) -> str:
    """Shorten the name of the program that holds the lease (the right to command): ``arm in process 12``
    becomes ``arm (12)``."""
    return f"{name.replace(' in process ', ' (')})" if " in process " in name else name


def age(age_s: float) -> Text:
    if age_s < 0:
        return Text("none", "red")
    shown = f"{age_s * 1e3:.0f} ms" if age_s < 1.0 else f"{age_s:.1f} s" if age_s < 100 else f"{age_s / 60:.0f} min"
    return Text(shown, "red" if age_s > GONE_S else "yellow" if age_s > LATE_S else "")


def facts(snapshot: RobotSnapshot) -> Table:
    """Return the table next to the processes: the state of the robot, and the reasons for it."""
    status = snapshot.status
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")

    def line(title: str, value: str | Text) -> None:
        table.add_row(title, value if isinstance(value, Text) else Text(value))

    line("robot", snapshot.note.kind)
    if status is None:
        line("state", Text.assemble(styled(snapshot.tree.state), ": its wire process does not answer"))
        return table
    line("state", state(snapshot))
    if status.locked_by:
        line("locked by", Text(f"{status.locked_by}. r lifts it", "magenta"))
    line("because", status.cause or NOTHING)
    if status.connect_error:
        line("link", Text(status.connect_error, "red"))
    line("lease", status.holder or NOTHING)
    line("last stop", _stop(status.last_stop))
    line("refused", f"{status.refusals}, last: {status.last_refusal}" if status.last_refusal else NOTHING)
    faults = {} if status.observation is None else status.observation.faults
    if faults:
        line("faults", Text("; ".join(f"{axis}: {fault}" for axis, fault in faults.items()), "yellow"))
    line("counted", f"{status.writes} writes, {status.reads} reads")
    return table


def _stop(report: StopReport | None) -> Text:
    if report is None:
        return NOTHING
    if not report.confirmed:
        return Text(f"NOT CONFIRMED by {', '.join(report.unconfirmed) or 'the robot'}", "bold red")
    count = len(report.motors)
    return Text(
        f"{report.safe_state}, {count} motor{'' if count == 1 else 's'} confirmed in {report.took_ms:.1f} ms"
    )


def _set(cell: Text, title: str, width: int) -> Text:
    """Return a cell with exactly the width of its column: cut if too long, and aligned."""
    cell = cell.copy()
    cell.truncate(width, overflow="ellipsis")
    cell.align("right" if title in RIGHT else "left", width)
    return cell


def heading(title: str, width: int) -> Text:
    return _set(Text(title, "dim"), title, width)
