"""Test the page of the kill matrix: unsafe cells stand out, and cells that do not apply give the reason."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class
from strands_actors.surfaces.cli import run
from strands_actors.surfaces.cli.matrix import one_of_each
from strands_actors.testing import Bench, Cell, Faults, Outcome, Victims, WireLog, cells, cells_of
from strands_actors.testing.bench import NotMoving, driver_of
from strands_actors.testing.cells import expected_of, read
from strands_actors.testing.faults import proves
from strands_actors.testing.jobs import Plan, measure_all
from strands_actors.testing.matrix import Row, measure, summary
from strands_actors.testing.matrix_page import columns_of, conditions, encode, load, page
from strands_actors.testing.queueing import DISTURBED_MS, Queue
from strands_actors.testing.trials import Problem, Trials, trial
from strands_actors.testing.worker import Order
from tests.cli.command import Command
from tests.spinning import spinning

from .blinky import Blinky

WIRE_KILL = Cell(Victims.WIRE, Faults.KILL, "", ("SAF-003",))


def outcome(safe_ms: float, after: int = 0, whole: bool = True, stood_ms: float = 0.0) -> Outcome:
    return Outcome("wire", "kill", "limp", safe_ms, 50.0, after, whole, stood_ms=stood_ms)


def some_trials(*outcomes: Outcome, path: Path | None = None) -> Trials:
    trials = Trials(path, jobs=2)
    for each in outcomes:
        trials.add(trial("so101", each))
    return trials


def test_saf_003_a_row_is_safe_only_when_every_trial_is() -> None:
    good = summary("so101", WIRE_KILL, [outcome(7.0), outcome(9.0), outcome(30.0)])
    assert (good.median_ms, good.worst_ms, good.bound_ms, good.trials, good.safe) == (9.0, 30.0, 50, 3, True)
    assert summary("so101", WIRE_KILL, [outcome(7.0), outcome(51.0)]).late == 1
    for bad in (outcome(7.0, after=2), outcome(7.0, whole=False)):
        row = summary("so101", WIRE_KILL, [outcome(7.0), bad])
        assert (row.safe, row.unsafe) == (False, 1)
    nothing = summary("so101", WIRE_KILL, [outcome(float("inf"), after=-1, whole=False)])
    assert (nothing.safe, nothing.setpoints_after) == (False, 0)


def test_late_is_excused_only_when_the_machine_explains_it_and_unsafe_never() -> None:
    assert outcome(70.0, stood_ms=30.0).disturbed
    assert not outcome(70.0, stood_ms=15.0).disturbed, "without the wait it would have been late, too"
    assert not outcome(51.0, stood_ms=DISTURBED_MS).disturbed, "so long a wait is usual"
    assert not outcome(40.0, stood_ms=30.0).disturbed, "not late"
    assert not outcome(70.0, after=1, stood_ms=30.0).disturbed
    assert not outcome(70.0, whole=False, stood_ms=30.0).disturbed
    row = summary("so101", WIRE_KILL, [outcome(7.0), outcome(70.0, stood_ms=30.0)])
    assert (row.trials, row.disturbed, row.worst_ms, row.late, row.safe) == (1, 1, 7.0, 0, True)
    row = summary("so101", WIRE_KILL, [outcome(7.0), outcome(70.0, after=1, stood_ms=30.0)])
    assert (row.trials, row.disturbed, row.unsafe, row.safe) == (2, 0, 1, False)
    assert not summary("so101", WIRE_KILL, []).safe, "a cell without trials is not safe"


def test_another_safe_state_is_excused_only_when_the_machine_explains_it_and_nothing_follows(
    tmp_path: Path,
) -> None:
    """A wire process that got no processor was fenced before the caller's lease lapsed. So the robot went limp
    and did not hold."""

    def read_of(stood_ms: float, *kinds: str, brought_to: str = "limp") -> Outcome:
        path = tmp_path / "wire.ndjson"
        rows = [{"t_ns": at, "from": "host", "kind": kind, "hex": ""} for at, kind in enumerate(kinds, 1)]
        for row in rows:
            if row["kind"] == "safe":
                row["safe_state"] = brought_to
        path.write_text("".join(json.dumps(row) + "\n" for row in rows))
        spin = Cell(Victims.CALLER, Faults.SPIN)
        return read(WireLog(path), expected_of(driver_of("so101"), spin), 0, 0, waited_ms=stood_ms)

    excused = read_of(30.0, "setpoint", "safe")
    assert (excused.safe_state, excused.instead, excused.safe, excused.disturbed) == ("hold", "limp", True, True)
    assert not read_of(0.0, "setpoint", "safe").safe
    moved = read_of(30.0, "setpoint", "safe", "setpoint")
    assert (moved.safe, moved.disturbed) == (False, False)
    assert not read_of(30.0, "setpoint").safe
    assert not read_of(30.0, "setpoint", "safe", brought_to="").safe, "one safe motor is not a safe robot"


def write_log(path: Path, kinds: str, mark: str) -> int:
    """Write one frame of the host per nanosecond, and none at ``mark``. Return the time of ``mark``."""
    words = kinds.split()
    rows = [{"t_ns": at, "from": "host", "kind": kind, "hex": ""} for at, kind in enumerate(words, 1)]
    path.write_text("".join(json.dumps(row) + "\n" for row in rows if row["kind"] != mark))
    return words.index(mark) + 1


@pytest.mark.parametrize(
    ("kinds", "since_ns"),
    [
        ("setpoint safe read stop safe", 2),
        ("setpoint safe setpoint stop safe", None),
        ("setpoint safe setpoint safe safe stop", 4),
        ("setpoint read stop safe", None),
    ],
)
def test_a_robot_that_the_fault_had_brought_to_the_safe_state_is_safe_when_the_stop_comes(
    kinds: str, since_ns: int | None, tmp_path: Path
) -> None:
    path = tmp_path / "wire.ndjson"
    stopped_ns = write_log(path, kinds, "stop")
    expected = expected_of(driver_of("so101"), Cell(Victims.TWIN, Faults.DELAYED))
    assert cells.safe_before(WireLog(path), expected, 1, stopped_ns) == since_ns
    limp = expected._replace(safe_states=("limp",))
    path.write_text(path.read_text().replace('"hex": ""', '"hex": "", "safe_state": "hold"'))
    assert cells.safe_before(WireLog(path), limp, 1, stopped_ns) is None, "another safe state does not count"


@pytest.mark.parametrize(
    ("kinds", "safe", "safe_ms"),
    [
        ("setpoint safe read back read read", True, 0.0),
        ("setpoint safe setpoint back read", False, float("inf")),
        ("setpoint safe back read safe", True, 2e-6),
        ("setpoint safe back setpoint read", False, 0.0),
    ],
)
def test_frames_that_reached_a_frozen_robot_count_when_it_is_back(
    kinds: str, safe: bool, safe_ms: float, tmp_path: Path
) -> None:
    """The log has the time at which a frame arrived, not the time at which the robot read it."""
    path = tmp_path / "wire.ndjson"
    back_ns = write_log(path, kinds, "back")
    cell = Cell(Victims.TWIN, Faults.FREEZE)
    expected = expected_of(driver_of("unitree_g1"), cell)
    outcome = cells.read_robot(WireLog(path), cell, expected, 1, back_ns, 0.0)
    assert (outcome.safe, outcome.safe_ms) == (safe, safe_ms)


def test_an_unsafe_trial_is_reported_with_its_wire_log(tmp_path: Path) -> None:
    path = tmp_path / "wire.ndjson"
    kinds = [
        ("host", "enable"),
        *[("host", "setpoint")] * 3,
        ("robot", "read"),
        ("robot", "answer"),
        ("robot", "watchdog"),
    ]
    rows = [{"t_ns": at * 10**6, "from": who, "kind": kind, "hex": ""} for at, (who, kind) in enumerate(kinds)]
    rows.append({"t_ns": 7_500_000, "from": "host", "kind": "safe", "hex": "", "safe_state": "limp"})
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    story = WireLog(path).story(10**6)
    assert story == "0.0 host setpoint x 3, 5.0 robot watchdog x 1, 6.5 host safe (limp) x 1"
    assert WireLog(path).story(10**9) == "nothing"
    lines = [
        cells.with_story(each, WireLog(path), 10**6)
        for each in (outcome(7.0), outcome(7.0, after=1), outcome(70.0))
    ]
    assert [each.story for each in lines] == ["", story, story]
    row = summary("so101", WIRE_KILL, lines)
    assert row.stories == (story, story)
    text = page(columns_of([row], some_trials(*lines, path=tmp_path / "trials.jsonl")))
    assert f"wire kill, not safe: from the fault on the wire showed {story}." in " ".join(text.split())
    assert [each.story for each in Trials(tmp_path / "trials.jsonl", 1).of("so101", WIRE_KILL)] == [
        "",
        story,
        story,
    ]


def test_a_run_that_was_ended_is_continued(tmp_path: Path) -> None:
    path = tmp_path / "trials.jsonl"
    drivers: dict[str, type[Driver] | None] = {"so101": None}
    some_trials(outcome(7.0), outcome(float("inf"), after=-1, whole=False), path=path)
    with path.open("ab") as file:
        file.write(b'{"half a li')
    again = Trials(path, jobs=4)
    assert [each.safe_ms for each in again.of("so101", WIRE_KILL)] == [7.0, float("inf")]
    assert [run.jobs for run in again.runs] == [2, 4]
    taken = conditions(again, "so101")
    assert (taken["trials"], taken["jobs"]) == ("2, of which disturbed: 0", "2 or 4 at a time")
    orders = left(Plan(drivers, 3, again, usual_cells))
    assert [order.trials for order in orders if (order.victim, order.fault) == ("wire", "kill")] == [1]
    assert [order.trials for order in orders if (order.victim, order.fault) == ("wire", "freeze")] == [3]
    path.write_bytes(path.read_bytes().replace(b"cores", b"CORES"))
    with pytest.raises(Problem, match="was measured with"):
        Trials(path, jobs=1)


def test_one_robot_is_measured_again_and_the_page_keeps_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_bench(*_: object) -> list[str]:
        return []

    out = tmp_path / "matrix.md"
    koch = summary("koch", WIRE_KILL, [outcome(float("inf"), after=-1, whole=False), outcome(8.0)])
    so101 = summary("so101", WIRE_KILL, [outcome(7.0)])
    out.with_suffix(".json").write_bytes(encode(columns_of([koch, so101], some_trials(outcome(7.0)))))
    kept = load(out.with_suffix(".json"))
    assert kept["koch"].rows == [koch] and kept["koch"].rows[0].worst_ms is None
    monkeypatch.setattr("strands_actors.surfaces.cli.matrix.trio.run", no_bench)  # the test measures nothing
    monkeypatch.setattr("strands_actors.surfaces.cli.matrix._roles_of", lambda _: {"so101": ("root", "standby")})
    assert run(["matrix", "--drivers", "so101", "-o", str(out)]) == 1
    written = load(out.with_suffix(".json"))
    assert list(written) == ["koch", "so101"] and written["koch"] == kept["koch"]
    assert len(written["so101"].rows) == len(list(cells_of(driver_of("so101"), ["standby"])))
    assert run(["matrix", "--drivers", "so101", "--victims", "nobody"]) == 2
    text = out.read_text()
    assert "| never **not safe** |" in text and "**not measured**" in text


@pytest.mark.parametrize(
    ("name", "message"), [("m.json", "Give a path *.md"), ("m.md", "not the data of a matrix")]
)
def test_a_file_that_is_no_matrix_page_is_not_overwritten(
    name: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there = tmp_path / "m.json"
    there.write_text('{"so101": 1}')
    assert run(["matrix", "--drivers", "so101", "-o", str(tmp_path / name)]) == 2
    assert message in capsys.readouterr().err
    assert there.read_text() == '{"so101": 1}' and len(list(tmp_path.iterdir())) == 1


def usual_cells(robot: str, driver: Driver) -> Iterator[Cell]:
    return cells_of(driver)


def left(plan: Plan, robot: str = "") -> list[Order]:
    """Return the orders for a worker that has a bench of ``robot``."""
    orders: list[Order] = []
    while (order := plan.next_for(orders[-1].robot if orders else robot)) is not None:
        orders.append(order)
    return orders


def test_a_robot_that_runs_first_has_one_bench_and_every_order_is_given_once() -> None:
    drivers: dict[str, type[Driver] | None] = {"so101": None, "unitree_g1": None}
    plan = Plan(drivers, 11, some_trials(), usual_cells)
    first = [order for _ in range(4) if (order := plan.next_for("")) is not None]
    assert [order.robot for order in first] == ["unitree_g1", "so101", "so101", "so101"]
    trials = sum(order.trials for order in [*first, *left(plan, "unitree_g1")])
    assert trials == 11 * sum(not cell.why_not for robot in drivers for cell in cells_of(driver_of(robot)))


def test_a_process_that_waits_for_a_processor_is_seen_to() -> None:
    """Two spinning processes share one processor, so each waits half of the time."""
    alone = {min(os.sched_getaffinity(0))}
    with spinning(2) as processes:
        for process in processes:
            os.sched_setaffinity(process.pid, alone)
        queue, idle = Queue([process.pid for process in processes]), Queue([])
        deadline_s = time.monotonic() + 20.0
        while queue.waited_ms() < 50.0:
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        assert idle.waited_ms() == 0.0


def test_the_page_shows_figures_reasons_and_conditions() -> None:
    rows = [
        summary("so101", WIRE_KILL, [outcome(7.0), outcome(9.0)]),
        Row("so101", "caller", "garbage", "only the robot itself can have such a fault"),
    ]
    trials = some_trials(outcome(7.0), outcome(9.0))

    def shown(*rows: Row) -> str:
        return " ".join(page(columns_of(rows, trials)).split())

    text = shown(*rows)
    assert "| wire | kill | limp | 8.0 | 9.0 | 50 | 0 | 2 | 0 | SAF-003 |" in text
    assert "* caller was not tested with garbage. Reason: only the robot itself can have such a fault." in text
    assert "1 cells, 2 trials, at least 2 in each cell, 0 setpoints after a safe frame: every cell safe" in text
    for key in ("date", "machine", "load", "python", "strands-actors", "jobs", "trials"):
        assert f"{key}: " in text
    excused = [outcome(70.0, stood_ms=30.0)] * 2
    assert summary("so101", WIRE_KILL, [*excused, outcome(7.0), outcome(8.0)]).safe
    assert "8.0 **mostly disturbed** |" in shown(summary("so101", WIRE_KILL, [*excused, outcome(8.0)]))
    unsafe = shown(summary("so101", WIRE_KILL, [outcome(7.0, after=1)]))
    assert "**not safe**" in unsafe
    assert "**1 not safe" in unsafe


@pytest.mark.long
def test_two_trials_of_a_third_party_driver() -> None:
    (row,) = measure(
        "blinky", 2, Blinky, only=lambda cell: (cell.victim, cell.fault) == (Victims.WIRE, Faults.KILL)
    )
    assert (row.robot, row.victim, row.fault, row.safe_state, row.trials) == ("blinky", "wire", "kill", "limp", 2)
    assert (row.unsafe, row.setpoints_after) == (0, 0)
    assert 0 < row.median_ms <= row.worst_ms


@pytest.mark.long
def test_parallel_trials_of_a_third_party_driver() -> None:
    """The trials run in worker processes. A worker reports the orders that it cannot measure."""
    drivers: dict[str, type[Driver] | None] = {"blinky": Blinky}
    plan, trials = Plan(drivers, 1, some_trials(), usual_cells), some_trials()
    orders = [order for order in left(plan) if (order.victim, order.fault) == ("wire", "kill")]
    problems = trio.run(
        measure_all, Given([*orders, msgspec.structs.replace(orders[0], driver="no:Where")]), 1, trials.add
    )
    assert [each.cell for each in trials.all] == [("blinky", "wire", "kill")]
    assert len(problems) == 1, problems


class Given(Plan):
    """A plan with exactly these orders."""

    def __init__(self, orders: list[Order]) -> None:
        self._orders = orders

    def next_for(self, robot: str) -> Order | None:
        return self._orders.pop(0) if self._orders else None


def test_a_policy_that_has_ended_before_it_was_to_break_is_begun_again(monkeypatch: pytest.MonkeyPatch) -> None:
    began: list[str] = []
    ended: list[str] = []

    class NobodyBreaks:
        driver = driver_of("so101")

        def moving(self, motion: str, extras: frozenset[str]) -> NobodyBreaks:
            began.append(motion)
            return self

        def drop(self) -> None:
            ended.append(began[-1])

        def pid(self, role: str) -> int:
            return os.getpid()

        def queue(self, caller: object, victim: int) -> Queue:
            return Queue(())

    async def inflict(*_: object) -> int:
        raise NotMoving("it had ended")

    monkeypatch.setattr(cells, "inflict", inflict)
    with pytest.raises(NotMoving, match=r"^it had ended$"):
        cells.run_cell(Cell(Victims.POLICY, Faults.SPIN, "", ()), NobodyBreaks())  # type: ignore[arg-type]
    assert began == ended == ["task"] * cells.STARTS, "a tree that could not be broken is not used again"


@pytest.mark.long
def test_a_caller_is_forked_from_one_thread_into_a_new_session() -> None:
    with Bench("blinky", Blinky) as bench:
        template = bench.template.pid
        assert len(os.listdir(f"/proc/{template}/task")) == 1
        caller = bench.moving("loop")
        assert len(os.listdir(f"/proc/{template}/task")) == 1
        pid = caller.process.pid
        assert os.getsid(pid) == pid
        root = caller.pids()["root"]
        caller.send_order("exit")
        caller.line()
        deadline_s = time.monotonic() + 20.0
        while caller.process.alive or Path(f"/proc/{root}").exists():
            assert time.monotonic() < deadline_s
            time.sleep(0.005)


def test_by_default_there_is_one_robot_of_each_driver() -> None:
    robots = one_of_each()
    drivers = [get_native_driver_class(robot) for robot in robots]
    assert len(set(drivers)) == len(robots) >= 4


def test_every_requirement_about_breaking_things_is_proved_by_some_cell() -> None:
    found = {saf for cell in cells_of(driver_of("so101")) if not cell.why_not for saf in cell.proves}
    assert {"SAF-001", "SAF-002", "SAF-003", "SAF-004", "SAF-005", "SAF-008", "SAF-012", "SAF-015"} <= found
    assert "SAF-015" not in proves(Victims.CALLER, Faults.FREEZE)


@pytest.mark.parametrize(
    ("arguments", "named"), [(["--drivers", "so999"], "so999"), (["--repeats", "0"], "--repeats")]
)
def test_invalid_arguments_of_the_matrix_are_refused_in_one_line(
    cli: Command, arguments: list[str], named: str, tmp_path: Path
) -> None:
    done = cli.run("matrix", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert named in done.stderr


MOVING = """
import time
from strands_actors.testing.bench import moving_robot
with moving_robot("so101") as (bench, caller):
    caller.send_order("spin")
    print(caller.process.pid, bench.twin.process.pid, flush=True)
    time.sleep(600)
"""


@pytest.mark.long
def test_a_bench_that_is_killed_leaves_neither_a_caller_that_spins_nor_a_twin() -> None:
    with subprocess.Popen([sys.executable, "-c", MOVING], stdout=subprocess.PIPE, text=True) as bench:
        try:
            assert bench.stdout is not None
            left = [Path(f"/proc/{pid}") for pid in bench.stdout.readline().split()]
            assert len(left) == 2 and all(map(Path.exists, left))
        finally:
            bench.kill()
    deadline_s = time.monotonic() + 20.0
    while any(map(Path.exists, left)):
        assert time.monotonic() < deadline_s, left
        time.sleep(0.01)
