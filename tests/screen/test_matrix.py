"""The kill matrix as a page: what is not safe stands out, what is not applicable says why."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from strands_actors.cli.matrix import one_of_each
from strands_actors.drivers import get_native_driver_class
from strands_actors.testing import Cell, Faults, Outcome, Victims, cells_of
from strands_actors.testing.bench import driver_of
from strands_actors.testing.faults import proves
from strands_actors.testing.matrix import Row, as_json, conditions, measure, page, summary
from tests.cli.command import Command

from .blinky import Blinky

WIRE_KILL = Cell(Victims.WIRE, Faults.KILL, "", ("SAF-003",))


def outcome(safe_ms: float, after: int = 0, whole: bool = True) -> Outcome:
    return Outcome("wire", "kill", "limp", safe_ms, 50.0, after, whole)


def test_saf_003_a_row_is_safe_only_when_every_trial_is() -> None:
    good = summary("so101", WIRE_KILL, [outcome(7.0), outcome(9.0), outcome(30.0)])
    assert (good.median_ms, good.worst_ms, good.bound_ms, good.trials, good.safe) == (9.0, 30.0, 50, 3, True)
    assert summary("so101", WIRE_KILL, [outcome(7.0), outcome(51.0)]).late == 1
    for bad in (outcome(7.0, after=2), outcome(7.0, whole=False)):
        row = summary("so101", WIRE_KILL, [outcome(7.0), bad])
        assert (row.safe, row.unsafe) == (False, 1)
    nothing = summary("so101", WIRE_KILL, [outcome(float("inf"), after=-1, whole=False)])
    assert (nothing.safe, nothing.setpoints_after) == (False, 0)


def test_the_page_shows_figures_reasons_and_conditions() -> None:
    rows = [
        summary("so101", WIRE_KILL, [outcome(7.0), outcome(9.0)]),
        Row("so101", "caller", "garbage", "a fault of the robot's end of the wire"),
    ]
    text = page(rows, conditions())
    assert "| wire | kill | limp | 8.0 | 9.0 | 50 | 0 | 2 | SAF-003 |" in text
    assert "* caller: garbage: a fault of the robot's end of the wire." in text
    assert "1 cells, 2 trials, 0 setpoints after a safe frame: every one safe" in text
    for key in ("date", "machine", "load", "python"):
        assert f"| {key} |" in text
    unsafe = page([summary("so101", WIRE_KILL, [outcome(7.0, after=1)])], conditions())
    assert "**not safe**" in unsafe
    assert "**1 not safe" in unsafe
    assert json.loads(as_json(rows, conditions()))["safe"] is True


def test_two_trials_of_a_driver_of_somebody_elses() -> None:
    (row,) = measure(
        "blinky", 2, Blinky, only=lambda cell: (cell.victim, cell.fault) == (Victims.WIRE, Faults.KILL)
    )
    assert (row.robot, row.victim, row.fault, row.rung, row.trials) == ("blinky", "wire", "kill", "limp", 2)
    assert (row.unsafe, row.setpoints_after) == (0, 0)
    assert 0 < row.median_ms <= row.worst_ms


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
def test_what_is_asked_wrongly_is_one_line(cli: Command, arguments: list[str], named: str, tmp_path: Path) -> None:
    done = cli.run("matrix", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert named in done.stderr
