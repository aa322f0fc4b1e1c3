"""The table of a replay is readable on a screen of any width."""

from __future__ import annotations

from rich.console import Console

from tests.explorer.invariants import Violation
from tests.explorer.table import history_table
from tests.explorer.world import BEGIN_S, Row


def test_every_line_of_a_narrow_table_has_time_and_process() -> None:
    rows = [Row(BEGIN_S + 0.25, "second operator", "sends", "ask gate " + 40 * "['Stop', 'stop', 'operator'] ")]
    broken = [Violation("SAF-018 a lock is obeyed", BEGIN_S + 0.5, 300 * "x")]
    console = Console(width=70)
    with console.capture() as shown:
        console.print(history_table(rows, broken, full=True))
    lines = shown.get().splitlines()
    assert [line.split() for line in lines if "0.2500" in line and "second operator" in line and "ask gate" in line]
    assert [line for line in lines if "0.5000" in line and "BROKEN" in line and "SAF-018" in line]
    assert len(lines) == 7, "each event takes one line, at any length"
