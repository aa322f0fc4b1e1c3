"""SAF-002, SAF-003, SAF-004, SAF-005, SAF-008, SAF-012, SAF-015: any one process, or the robot
itself, breaks in any way, and the wire shows the safe state. The short form of the kill matrix:
each cell once.

Real processes, real wires. The bounds are the published ones, but for the time for which processes
stood in line for a processor. ``strands-actors matrix --repeats 50`` measures them.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from strands_actors.testing import Bench, Cell, Faults, Victims, cells_of, run_cell
from strands_actors.testing.bench import driver_of
from strands_actors.testing.faults import spoils

GONE_MS = 500.0
"""For a caller to end, with the interpreter's own end."""
SETTLE_S = 0.2
WHOLE = ("so101", "unitree_g1")
"""A serial bus, and a wire of 500 Hz. Of the other drivers the seven hardest cells are run with their
conformance; the whole matrix is measured by hand."""


def quick(robot: str, cell: Cell) -> bool:
    """A 500 Hz wire takes a processor: of its cells those of processes that are gone, or frozen."""
    return robot == WHOLE[0] or cell.fault in (Faults.KILL, Faults.FREEZE)


CELLS = [
    pytest.param(robot, cell, marks=() if quick(robot, cell) else pytest.mark.long, id=f"{robot}-{cell}")
    for robot in WHOLE
    for cell in cells_of(driver_of(robot))
    if not cell.why_not
]


@pytest.fixture(scope="module")
def benches() -> Iterator[dict[str, Bench]]:
    """The one bench in use. Cells come robot by robot: the one before is ended when the next
    begins."""
    benches: dict[str, Bench] = {}
    yield benches
    for bench in benches.values():
        bench.__exit__(None, None, None)


@pytest.mark.parametrize(("robot", "cell"), CELLS)
def test_saf_003_one_breaks_and_the_wire_is_safe(robot: str, cell: Cell, benches: dict[str, Bench]) -> None:
    if robot not in benches:
        for other in list(benches):
            benches.pop(other).__exit__(None, None, None)
        benches[robot] = Bench(robot).__enter__()
    outcome = run_cell(cell, benches[robot], SETTLE_S)
    assert outcome.all_motors, f"no {outcome.safe_state} frame for all motors, but {outcome.story}"
    assert outcome.setpoints_after == 0, outcome.story
    assert outcome.on_time, outcome.story
    # SAF-015: nothing of ours keeps a caller that ends.
    assert outcome.gone_ms <= GONE_MS


@pytest.mark.parametrize(
    ("victim", "fault", "spoilt"),
    [
        (Victims.CALLER, Faults.FREEZE, True),
        (Victims.WIRE, Faults.KILL, False),  # the root starts another
        ("standby", Faults.KILL, False),
        ("recorder", Faults.KILL, False),
        ("camera/eye", Faults.KILL, True),  # it is waited for longer each time
        ("camera/eye", Faults.FREEZE, False),  # it is let go afterwards
        ("spawner", Faults.KILL, True),
        ("standby/stop", Faults.KILL, True),
    ],
)
def test_a_tree_is_broken_again_only_when_it_is_whole_again(victim: str, fault: Faults, spoilt: bool) -> None:
    assert spoils(victim, fault) is spoilt


def test_every_victim_and_every_fault_is_a_cell_or_says_why_not() -> None:
    cells = list(cells_of(driver_of("robotiq_2f85")))
    assert {(cell.victim, cell.fault) for cell in cells} == {(v, f) for v in Victims for f in Faults}
    for cell in cells:
        assert bool(cell.why_not) != bool(cell.proves)
    why = {cell.why_not for cell in cells if cell.victim is Victims.POLICY and cell.fault is Faults.KILL}
    assert why == {driver_of("robotiq_2f85").ROLLOUTS}
