"""SAF-003: test a robot that walks by its onboard controller while one of our processes ends or freezes.

These are a few cells of the kill matrix. ``strands-actors matrix --drivers unitree_go2:sport unitree_g1:sport``
runs them all.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from strands_actors.testing import Bench, Cell, Faults, Victims, cells_of, run_cell
from strands_actors.testing.bench import driver_of

KILLS = ((Victims.CALLER, Faults.KILL), (Victims.WIRE, Faults.KILL), (Victims.ROOT, Faults.KILL))
HANDFUL = {
    "unitree_go2:sport": (*KILLS, (Victims.WIRE, Faults.FREEZE)),
    "unitree_g1:sport": KILLS,
    "unitree_h1:sport": KILLS[1:2],
}


def handful() -> Iterator[Any]:
    """Yield one test per cell, sorted by bench."""
    for column, wanted in HANDFUL.items():
        cells = [cell for cell in cells_of(driver_of(column)) if (cell.victim, cell.fault) in wanted]
        assert len(cells) == len(wanted)
        yield from (pytest.param(column, cell, id=f"{column}-{cell}") for cell in cells)


@pytest.fixture(scope="module")
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    with Bench(request.param) as bench:
        yield bench


@pytest.mark.real_time
@pytest.mark.parametrize(("bench", "cell"), list(handful()), indirect=["bench"])
def test_saf_003_a_robot_that_walks_stands_when_a_process_breaks(cell: Cell, bench: Bench) -> None:
    assert not cell.why_not
    outcome = run_cell(cell, bench)
    assert outcome.all_motors, f"no {outcome.safe_state} frame, but {outcome.story}"
    assert outcome.safe_state == "stop"
    assert outcome.setpoints_after == 0, outcome.story
    assert outcome.on_time, outcome.story
