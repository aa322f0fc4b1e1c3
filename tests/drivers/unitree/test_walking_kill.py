"""SAF-003: a robot that walks by its onboard controller, and one process of ours that ends or freezes.
A handful of the cells of the kill matrix; ``strands-actors matrix --drivers unitree_go2:sport`` has
them all."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from strands_actors.testing import Bench, Cell, Faults, Victims, cells_of, run_cell
from strands_actors.testing.bench import driver_of

COLUMN = "unitree_go2:sport"
SLACK_MS = 400.0
HANDFUL = (
    (Victims.CALLER, Faults.KILL),
    (Victims.WIRE, Faults.KILL),
    (Victims.WIRE, Faults.FREEZE),
    (Victims.ROOT, Faults.KILL),
)
CELLS = [cell for cell in cells_of(driver_of(COLUMN)) if (cell.victim, cell.fault) in HANDFUL]


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    with Bench(COLUMN) as bench:
        yield bench


@pytest.mark.real_time
@pytest.mark.parametrize("cell", CELLS, ids=str)
def test_saf_003_a_robot_that_walks_stands_when_a_process_breaks(cell: Cell, bench: Bench) -> None:
    assert len(CELLS) == len(HANDFUL) and not cell.why_not
    outcome = run_cell(cell, bench)
    assert outcome.all_motors, f"no {outcome.safe_state} frame, but {outcome.story}"
    assert outcome.safe_state == "stop"
    assert outcome.setpoints_after == 0, outcome.story
    assert outcome.safe_ms <= outcome.bound_ms + SLACK_MS, outcome.story
