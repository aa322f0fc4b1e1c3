"""SAF-002, SAF-003, SAF-004, SAF-005, SAF-008, SAF-012, SAF-015: any one process, or the robot
itself, breaks in any way, and the wire shows the safe state. The short form of the kill matrix:
each cell once.

Real processes, real wires. The bounds here leave room for a busy machine; the published ones are
held by ``strands-actors matrix --repeats 50``.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from strands_actors.testing import Bench, Cell, Faults, Victims, cells_of, run_cell
from strands_actors.testing.bench import driver_of
from strands_actors.testing.conformance import CELLS as HARDEST_CELLS

SLACK_MS = 400.0
SETTLE_S = 0.2
WHOLE = ("so101", "robotiq_2f85", "ur5e", "unitree_g1")
"""Every cell of these: a serial bus, a connection made when needed, an SDK, a wire of 500 Hz."""
HARDEST = (
    "koch",
    "xarm7",
    "kuka_iiwa",
    "kinova_gen3",
    "panda",
    "earthrover",
    "yahboom_m3pro",
    "reachy_mini",
    "crazyflie",
    "booster_t1",
    "unitree_go2",
)
"""Of the other drivers the seven cells of the conformance suite; the whole matrix is measured by
hand."""

CELLS = [
    (robot, cell)
    for robot in (*WHOLE, *HARDEST)
    for cell in cells_of(driver_of(robot))
    if not cell.why_not and (robot in WHOLE or (cell.victim, cell.fault) in HARDEST_CELLS)
]


@pytest.fixture(scope="module")
def benches() -> Iterator[dict[str, Bench]]:
    """The one bench in use. Cells come robot by robot: the one before is ended when the next
    begins."""
    benches: dict[str, Bench] = {}
    yield benches
    for bench in benches.values():
        bench.__exit__(None, None, None)


@pytest.mark.parametrize(("robot", "cell"), CELLS, ids=str)
def test_saf_003_one_breaks_and_the_wire_is_safe(robot: str, cell: Cell, benches: dict[str, Bench]) -> None:
    if robot not in benches:
        for other in list(benches):
            benches.pop(other).__exit__(None, None, None)
        benches[robot] = Bench(robot).__enter__()
    outcome = run_cell(cell, benches[robot], SETTLE_S)
    assert outcome.all_motors, f"no {outcome.safe_state} frame for all motors, but {outcome.story}"
    assert outcome.setpoints_after == 0, outcome.story
    assert outcome.safe_ms <= outcome.bound_ms + SLACK_MS, outcome.story
    # SAF-015: nothing of ours keeps a caller that ends.
    assert outcome.gone_ms <= 100.0 + SLACK_MS


def test_every_victim_and_every_fault_is_a_cell_or_says_why_not() -> None:
    cells = list(cells_of(driver_of("robotiq_2f85")))
    assert {(cell.victim, cell.fault) for cell in cells} == {(v, f) for v in Victims for f in Faults}
    for cell in cells:
        assert bool(cell.why_not) != bool(cell.proves)
    why = {cell.why_not for cell in cells if cell.victim is Victims.POLICY and cell.fault is Faults.KILL}
    assert why == {driver_of("robotiq_2f85").ROLLOUTS}
