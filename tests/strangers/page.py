"""Write the results as a table: to the terminal, into ``record.json``, and into ``docs/testing.md``.

The record keeps the last result of every program, so that a run of one client changes only the rows of this client.
``python -m tests strangers --page`` runs the programs and writes the record and the page. A test compares the page
with the record.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import date
from pathlib import Path, PurePath
from typing import Any

from .body import AxisWay
from .table import HERE, Client, Program
from .verdict import GOOD, HONEST, Verdict

ROOT = HERE.parents[1]
RECORD = HERE / "record.json"
PAGE = ROOT / "docs" / "testing.md"
AXES = 3
"""The most axes that a row names. The one that moved furthest comes first."""
TITLES = ("client", "program", "robot", "calls", "what moved", "verdict")
KINDS = ("setpoint", "safe", "enable", "config")
"""Kinds of frames that a row names, in this order. All others are counted together as readings."""

Row = Mapping[str, Any]


def calls_of(calls: Mapping[str, int]) -> str:
    """Return the number of frames by kind in a few words."""
    named = [f"{calls[kind]} {kind}" for kind in KINDS if calls.get(kind)]
    others = sum(count for kind, count in calls.items() if kind not in KINDS)
    return ", ".join([*named, *([f"{others} other"] if others else [])]) or "no frame"


def moved_of(moved: Mapping[str, AxisWay]) -> str:
    """Return what moved in a few words: where each axis began and ended, in rad or m."""
    named = [f"{axis} {_way_of(row)}" for axis, row in list(moved.items())[:AXES]]
    rest = len(moved) - len(named)
    return ", ".join([*named, *([f"{rest} more"] if rest else [])]) or "nothing"


def _way_of(row: AxisWay) -> str:
    """Return start and end of an axis. If it came back, return the place where it turned."""
    if abs(row.end - row.start) < 0.5 * row.range:
        return f"{row.start:.2f} to {row.furthest:.2f}, and to {row.end:.2f}"
    return f"{row.start:.2f} to {row.end:.2f}"


def row_of(
    client: Client,
    program: Program,
    robot: str,
    verdict: Verdict,
    reason: str,
    day: date,
    calls: Mapping[str, int] | None = None,
    moved: Mapping[str, AxisWay] | None = None,
) -> Row:
    """Return the row of one program, as the record keeps it. Without ``calls`` it was not run."""
    return {
        "client": f"{client.name} {client.version}",
        "program": program.name,
        "ours": program.file.startswith("own:"),
        "robot": robot,
        "calls": "" if calls is None else calls_of(calls),
        "moved": "" if moved is None else moved_of(moved),
        "verdict": str(verdict),
        "reason": reason,
        "note": program.note,
        "date": day.isoformat(),
    }


def key_of(row: Row) -> tuple[str, str]:
    return row["client"], row["program"]


def merged(old: Iterable[Row], new: Iterable[Row], table: Sequence[Client]) -> list[Row]:
    """Return the rows of all programs in the order of the table: the new ones, and the old ones of the others.

    Rows of programs that the table no longer has are left out.
    """
    rows = {key_of(row): row for row in [*old, *new]}
    return [rows[key] for client in table for key in _keys(client, rows)]


def _keys(client: Client, rows: Mapping[tuple[str, str], Row]) -> list[tuple[str, str]]:
    """Return the keys of a client's rows: those of the table first, then those that fit a pattern."""
    name = f"{client.name} {client.version}"
    known = [(name, program.name) for program in client.program]
    fitting = [key for key in rows if key[0] == name and any(PurePath(key[1]).match(one) for one in client.every)]
    return [key for key in dict.fromkeys([*known, *sorted(fitting)]) if key in rows]


def summary(rows: Sequence[Row]) -> str:
    """Return the figures of all rows as two or three sentences."""
    verdicts = Counter(row["verdict"] for row in rows)
    run = [row for row in rows if row["verdict"] != Verdict.ABSENT]
    good = sum(verdicts[verdict] for verdict in GOOD)
    clients = len({row["client"] for row in run})
    text = [
        f"{len(run)} programs of {clients} clients: {good} ran to their end. Of these {verdicts[Verdict.REACHED]} "
        f"left the body where the program sends it, {verdicts[Verdict.MOVED]} moved it, and "
        f"{verdicts[Verdict.RAN]} did not ask for a move. "
        f"{verdicts[Verdict.REFUSED]} got the robot's own error, "
        f'{verdicts[Verdict.NOTHING]} were told "done" for nothing.'
    ]
    rest = {verdict: verdicts[verdict] for verdict in Verdict if verdict not in HONEST and verdicts[verdict]}
    rest.pop(Verdict.NOTHING, None)
    if rest:
        text.append(f"The others: {', '.join(f'{count} {verdict}' for verdict, count in rest.items())}.")
    if verdicts[Verdict.BROKEN]:
        text.append(f"{verdicts[Verdict.BROKEN]} have a fault of the vendor's.")
    if verdicts[Verdict.ABSENT]:
        text.append(f"{verdicts[Verdict.ABSENT]} more were not run on this machine.")
    return " ".join(text)


def table_of(rows: Sequence[Row]) -> str:
    """Return the rows as a table in Markdown."""
    lines = [f"| {' | '.join(TITLES)} |", f"|{'---|' * len(TITLES)}"]
    for row in rows:
        verdict = f"{row['verdict']} ({row['reason']})" if row["reason"] else row["verdict"]
        verdict += f". {row['note']}" if row["note"] else ""
        cells = (row["client"], f"`{row['program']}`", row["robot"], row["calls"], row["moved"], verdict)
        lines.append(f"| {' | '.join(_cell(cell) for cell in cells)} |")
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    """Return a text that is no Markdown. A name in backticks stays as it is."""
    if text.startswith("`"):
        return text
    return re.sub(r"([*_<])", r"\\\1", text.replace("|", "/"))


def text_of(rows: Sequence[Row]) -> str:
    """Return the section of the page; without rows it says that there are none."""
    if not rows:
        return "No run has been recorded yet.\n"
    days = sorted(date.fromisoformat(row["date"]) for row in rows)
    first, last = (f"{day.day} {day:%B %Y}" for day in (days[0], days[-1]))
    when = f"On {last}" if first == last else f"Between {first} and {last}"
    return f"{when}, {summary(rows)}\n\n{table_of(rows)}"


def page_with(page: str, name: str, text: str) -> str:
    """Return a page with a new text between the marks ``name: begin`` and ``name: end``.

    Raises:
        ValueError: The page does not have the two marks exactly once.
    """
    begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"
    place = re.compile(rf"(?<={re.escape(begin)}).*?(?={re.escape(end)})", re.DOTALL)
    if len(place.findall(page)) != 1:
        raise ValueError(f"{PAGE.name} must have {begin.strip()} and {end} once")
    return place.sub(lambda _: text, page)


def read(record: Path = RECORD) -> dict[str, list[Row]]:
    """Return the record: the rows of the programs, and those of the comparisons with simulators."""
    if not record.exists():
        return {"programs": [], "truth": []}
    found: dict[str, list[Row]] = json.loads(record.read_text())
    return found


def write(record: Mapping[str, Any], path: Path = RECORD) -> None:
    path.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")


__all__ = ["PAGE", "RECORD", "merged", "page_with", "read", "row_of", "summary", "table_of", "text_of", "write"]
