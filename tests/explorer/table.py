"""Print the plan and the history of a run as tables."""

from __future__ import annotations

from collections.abc import Iterable

from rich.table import Table
from rich.text import Text

from .invariants import Violation
from .links import told
from .plan import Plan
from .world import BEGIN_S, Row

COLOURS = {"plan": "bold yellow", "wire": "cyan", "mesh": "magenta"}
DULL = ("hosts ", "ask gate ['GetStatus'", "tell gate ['Beat'")


def plan_table(plan: Plan, title: str) -> Table:
    table = Table(title=title, title_justify="left")
    for name in ("at", "what", "who", "for", "motor"):
        table.add_column(name)
    table.add_row("0.0000 s", f"the caller connects, then: {plan.style}", "caller", "", "")
    for event in plan.events:
        motor = str(event.motor) if event.motor and not event.who else ""
        table.add_row(
            f"{event.at_s:.4f} s", event.kind, event.who, f"{event.value:g} s" if event.value else "", motor
        )
    return table


def history_table(rows: Iterable[Row], violations: Iterable[Violation], full: bool) -> Table:
    """Return the history of a run as a table.

    Args:
        full: Also show hosted addresses, heartbeats and requests for the status.
    """
    table = Table(title="history", title_justify="left")
    for name, width in (("at", 7), ("who", 15), ("does", 10)):
        table.add_column(name, no_wrap=True, overflow="ellipsis", width=width)
    # Only this column shrinks, so that no other one vanishes on a narrow screen.
    table.add_column("what")
    broken = sorted(violations, key=lambda violation: violation.t_s)
    for row in rows:
        while broken and broken[0].t_s < row.t_s:
            _add_violation(table, broken.pop(0))
        text = told(row.detail) if isinstance(row.detail, bytes) else row.detail
        if full or not (text.startswith(DULL) or "'Status'" in text):
            table.add_row(
                f"{row.t_s - BEGIN_S:.4f}", row.who, row.what, _in_a_line(text), style=COLOURS.get(row.who)
            )
    for violation in broken:
        _add_violation(table, violation)
    return table


def _add_violation(table: Table, violation: Violation) -> None:
    text = f"{violation.invariant}: {violation.detail}"
    table.add_row(f"{violation.t_s - BEGIN_S:.4f}", "", "BROKEN", _in_a_line(text), style="bold white on red")


def _in_a_line(text: str) -> Text:
    return Text(text, no_wrap=True, overflow="ellipsis")
