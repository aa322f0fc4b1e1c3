"""Test the table of clients, the verdicts, the page and the comparison, without a network and without a client."""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path
from typing import Any

import msgspec
import pytest

from . import page
from .body import AxisWay, Way
from .fetch import Fetched
from .run import fill, places_of
from .table import Client, Program, clients
from .truth.compare import Event, absent_of, differences, report, result_of
from .verdict import Seen, Verdict, judge, one_line

TURNED = AxisWay(0.0, 0.0, 0.3, 0.3)
STOOD = AxisWay(0.0, -0.001, 0.001, 0.0)


def seen(
    code: int | None = 0,
    *,
    pan: AxisWay = TURNED,
    output: str = "",
    calls: dict[str, int] | None = None,
    lost: str = "",
) -> Seen:
    rows = {"pan": pan, "lift": STOOD}
    moved = {axis: row for axis, row in rows.items() if row.range > 0.01}
    return Seen(code, output, {"setpoint": 3} if calls is None else calls, rows, moved, lost)


def program(**fields: Any) -> Program:
    return Program(file="own:x.py", **fields)


CASES = [
    (program(moves=True), seen(), Verdict.MOVED, ""),
    (program(), seen(), Verdict.MOVED, ""),
    (program(moves=("pan",)), seen(), Verdict.MOVED, ""),
    (program(reaches={"pan": 0.3}), seen(), Verdict.REACHED, ""),
    (program(reaches={"pan": 0.3, "lift": 0.0}), seen(), Verdict.REACHED, ""),
    (program(passes={"pan": 0.3}), seen(), Verdict.REACHED, ""),
    (program(passes={"pan": 0.5}), seen(), Verdict.ELSEWHERE, "should turn at 0.5"),
    (program(reaches={"pan": 0.4}), seen(), Verdict.ELSEWHERE, "pan is at 0.3, sent to 0.4"),
    (program(reaches={"pan": 0.4}, within=0.2), seen(), Verdict.REACHED, ""),
    (program(reaches={"pan": 0.3, "lift": 1.0}), seen(), Verdict.ELSEWHERE, "lift did not move; lift is at 0"),
    (program(moves=("lift",)), seen(), Verdict.NOTHING, "lift did not move"),
    (program(moves=("tilt",)), seen(), Verdict.ELSEWHERE, "no axis tilt"),
    (program(moves=True), seen(pan=STOOD), Verdict.NOTHING, "no axis moved"),
    (program(), seen(pan=STOOD), Verdict.NOTHING, "no axis moved"),
    (program(), seen(pan=STOOD, calls={"read": 9}), Verdict.RAN, ""),
    (program(moves=False), seen(pan=STOOD), Verdict.RAN, ""),
    (program(moves=False), seen(), Verdict.ELSEWHERE, "only reads"),
    (program(), seen(1, output="Traceback\nValueError: no\n\n"), Verdict.FAILED, "ValueError: no"),
    (program(), seen(-11), Verdict.FAILED, "exit code -11"),
    (program(), seen(None), Verdict.CUT_OFF, "after 60 s"),
    (program(endless=True), seen(None), Verdict.MOVED, ""),
    (program(endless=True), seen(None, pan=STOOD), Verdict.NOTHING, "no axis moved"),
    (program(refusal="not enabled", lacks="why"), seen(1, output="x not enabled y"), Verdict.REFUSED, "why"),
    (program(refusal="not enabled", lacks="why"), seen(pan=STOOD, output="fine"), Verdict.NOTHING, "no axis"),
    (program(refusal="NameError", broken="a name"), seen(1, output="NameError: x"), Verdict.BROKEN, "a name"),
    (program(moves=True), seen(pan=STOOD)._replace(errors=("no such function",)), Verdict.REFUSED, "no such"),
    (program(), seen(lost="the simulation ended"), Verdict.LOST, "ended"),
]


@pytest.mark.parametrize(("row", "what", "verdict", "reason"), CASES)
def test_the_body_decides_and_not_what_the_program_says(
    row: Program, what: Seen, verdict: Verdict, reason: str
) -> None:
    judged = judge(row, what)
    assert judged.verdict is verdict
    assert reason in judged.reason and bool(reason) is bool(judged.reason)


def test_a_way_has_start_extremes_and_end_and_small_changes_are_no_movement() -> None:
    way = Way(("a", "b", "c"))
    for row in ((0.0, 1.0, 5.0), (2.0, 1.004, 5.0), (0.5, 1.0, 4.9)):
        way.add(row)
    assert way.rows["a"] == AxisWay(0.0, 0.0, 2.0, 0.5)
    assert list(way.moved()) == ["a", "c"], "the axis that moved furthest comes first"


def test_the_text_of_an_error_has_no_path_of_this_machine() -> None:
    assert one_line('File "/home/me/.cache/x/prog.py",\n line 3') == 'File "prog.py", line 3'
    assert len(one_line("word " * 100)) == 100


def test_an_address_is_put_into_the_arguments() -> None:
    fetched = Fetched(Path("python"), Path("bin"), modules=Path("/cache/node_modules"))
    places = places_of("127.0.0.7:443?ca=/tmp/ca.pem\n", fetched)
    assert fill("{host} {port} {address} {ca} {modules} {other}", places) == (
        "127.0.0.7 443 127.0.0.7:443 /tmp/ca.pem /cache/node_modules {other}"
    )
    places = places_of("/tmp/a/tty", fetched)
    assert fill("{address} {folder} {host}", places) == "/tmp/a/tty /tmp/a /tmp/a/tty"


def test_the_table_of_clients_is_valid_and_pinned() -> None:
    table = clients()
    assert len({client.name for client in table}) == len(table) > 12
    assert all(client.version and client.program for client in table)


@pytest.mark.parametrize(
    ("program_row", "problem"),
    [
        ('file = "own:nothing.py"', "programs/nothing.py does not exist"),
        ('file = "example.py"', "does not say where examples are"),
        ('file = "command:x"\nmoves = false\nreaches = { a = 1.0 }', "without a move"),
        ('file = "command:x"\nlacks = "all"', "how the failure reads"),
        ('file = "command:x"\nspeed = 1', "unknown field `speed`"),
        ('file = "command:x"\n[[client.program]]\nfile = "module:x"', "has x twice"),
    ],
)
def test_a_wrong_row_is_refused(tmp_path: Path, program_row: str, problem: str) -> None:
    table = tmp_path / "clients.toml"
    head = '[[client]]\nname = "n"\nversion = "1"\nlicense = "MIT"\nrobot = "so101"\n[[client.program]]\n'
    table.write_text(head + program_row)
    with pytest.raises(ValueError, match=problem):
        clients(table)


# -- the page


CLIENT = Client(
    name="bus",
    version="1.0",
    license="MIT",
    robot="so101",
    program=(program(title="move"), program(title="read"), program(title="new")),
)


def row(title: str, verdict: Verdict, reason: str = "", day: int = 3, **more: Any) -> page.Row:
    one = next(each for each in CLIENT.program if each.title == title)
    return page.row_of(CLIENT, one, "so101", verdict, reason, date(2026, 11, day), **more)


def test_a_run_replaces_its_rows_and_keeps_the_others() -> None:
    old = [row("move", Verdict.FAILED, "x"), row("read", Verdict.RAN)]
    gone = {**row("read", Verdict.RAN), "program": "no longer in the table"}
    rows = page.merged([*old, gone], [row("move", Verdict.MOVED)], [CLIENT])
    assert [(each["program"], each["verdict"]) for each in rows] == [("move", "moved"), ("read", "ran")]

    # A program that only fits a pattern comes after the rows of the table.
    fits = {**row("read", Verdict.RAN), "program": "arm/0001-get.py"}
    of_patterns = msgspec.structs.replace(CLIENT, every=("arm/*.py",))
    assert [each["program"] for each in page.merged([fits, *old], [], [of_patterns])] == [
        "move",
        "read",
        "arm/0001-get.py",
    ]


def test_the_text_has_the_figures_the_days_and_the_rows() -> None:
    rows = [
        row("move", Verdict.MOVED, calls={"setpoint": 2, "read": 7, "safe": 1}, moved={"pan": TURNED}),
        row("read", Verdict.NOTHING, "no axis moved", 5, calls={}, moved={}),
        row("new", Verdict.ABSENT, "no a|b", 5),
    ]
    assert "1 have a fault of the vendor's." in page.summary([row("new", Verdict.BROKEN, "x")])
    text = page.text_of(rows)
    assert text.startswith("Between 3 November 2026 and 5 November 2026, 2 programs of 1 clients: 1 ran")
    assert "Of these 0 left the body where the program sends it, " in text
    assert '0 got the robot\'s own error, 1 were told "done" for nothing.' in text
    assert "1 more were not run on this machine." in text
    assert "| bus 1.0 | `move` | so101 | 2 setpoint, 1 safe, 7 other | pan 0.00 to 0.30 | moved |\n" in text
    assert "| no frame | nothing | done for nothing (no axis moved) |\n" in text
    assert "| not run (no a/b) |\n" in text
    written = page.page_with("a\n<!-- strangers: begin -->\nold\n<!-- strangers: end -->\nb\n", "strangers", text)
    assert written == f"a\n<!-- strangers: begin -->\n{text}<!-- strangers: end -->\nb\n"
    with pytest.raises(ValueError, match="once"):
        page.page_with("a", "strangers", text)


def test_the_page_has_the_recorded_results() -> None:
    recorded = page.read()
    text = page.PAGE.read_text()
    assert page.text_of(recorded["programs"]) in text, "run python -m tests strangers --write"
    for result in recorded["truth"]:
        assert report(result) in text, "run python -m tests strangers --write"
    kept = page.merged(recorded["programs"], [], clients())
    assert kept == recorded["programs"], "a row of a program that is gone, or another order"


# -- ground truth


THEIRS = [
    Event("hello", "200: a, b"),
    Event("moved", took_s=1.0, values={"yaw": 0.5, "x": 0.01}),
    Event("end"),
]


def changed(**fields: Any) -> list[Event]:
    return [each._replace(**fields) if each.name == "moved" else each for each in THEIRS]


@pytest.mark.parametrize(
    ("ours", "found"),
    [
        (THEIRS, []),
        (changed(took_s=1.25), []),
        (changed(took_s=1.6), [("moved", "time", "1.00 s", "1.60 s")]),
        (changed(values={"yaw": -0.5, "x": 0.01}), [("moved", "yaw (sign)", "0.500", "-0.500")]),
        (
            changed(values={"yaw": 28.65, "x": 0.01}),
            [("moved", "yaw (unit: degrees for radians?)", "0.500", "28.650")],
        ),
        (changed(values={"yaw": 0.6, "x": 0.01}), [("moved", "yaw", "0.500", "0.600")]),
        (changed(values={"yaw": 0.5}), [("moved", "x", "0.010", "not there")]),
        (changed(answer="404"), [("moved", "answer", "", "404")]),
        (THEIRS[:2], [("moved", "order: next comes", "end", "the end")]),
        ([THEIRS[0], THEIRS[2], THEIRS[1]], [("hello", "order: next comes", "moved, end", "end, moved")]),
    ],
)
def test_order_answers_times_signs_and_units_are_compared(ours: list[Event], found: list[tuple[str, ...]]) -> None:
    assert [tuple(each) for each in differences(THEIRS, ours)] == found


def test_a_comparison_is_recorded_and_reported() -> None:
    result = result_of("sim", "Sim 1", "so101", THEIRS, changed(took_s=2.0), "2026-11-03")
    assert json.loads(json.dumps(result)) == result
    text = report(result)
    assert "**Sim 1** and our twin of `so101` (2026-11-03): 3 events, 1 differences." in text
    assert "| moved | time | 1.00 s | 2.00 s |" in text
    assert "1 differences. It is slow.\n" in report({**result, "note": "It is slow."})
    assert "no difference" in report({**result, "differences": []})
    absent = absent_of("sim", "Sim 1", "so101", "it needs a network", "2026-11-03")
    assert report(absent) == "**Sim 1** (2026-11-03): not run on this machine: it needs a network\n"
