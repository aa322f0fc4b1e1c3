"""SAF-002, SAF-003, SAF-004, SAF-005, SAF-008, SAF-012, SAF-015: one process of a robot, or the robot
itself, fails in each possible way, and the wire log must show the safe state. This is the short form of
the kill matrix, with each cell once.

Processes and wires are real. The bounds are the published ones, plus the time for which processes waited
for a processor. ``strands-actors matrix --repeats 50`` measures them.
"""

from __future__ import annotations

import pytest

from strands_actors.testing import Cell, Faults, Victims, cells_of, run_cell
from strands_actors.testing.bench import driver_of
from strands_actors.testing.faults import spoils

from .conftest import BenchOf

GONE_MS = 500.0
"""Time for a caller to end, with the end of its interpreter."""
SETTLE_S = 0.2
WHOLE = ("so101", "unitree_g1")
"""A serial bus, and a wire at 500 Hz. The conformance tests of the other drivers run the seven hardest
cells. The whole matrix is measured by hand.
"""


def quick(robot: str, cell: Cell) -> bool:
    """Return whether a cell belongs to the ordinary run. A wire at 500 Hz needs a whole processor, so
    only its killed and frozen processes do.
    """
    return robot == WHOLE[0] or cell.fault in (Faults.KILL, Faults.FREEZE)


CELLS = [
    pytest.param(robot, cell, marks=() if quick(robot, cell) else pytest.mark.long, id=f"{robot}-{cell}")
    for robot in WHOLE
    for cell in cells_of(driver_of(robot))
    if not cell.why_not
]


@pytest.mark.parametrize(("robot", "cell"), CELLS)
def test_saf_003_one_process_fails_and_the_wire_is_safe(robot: str, cell: Cell, bench_of: BenchOf) -> None:
    outcome = run_cell(cell, bench_of(robot), SETTLE_S)
    assert outcome.all_motors, f"no {outcome.safe_state} frame for all motors, but {outcome.story}"
    assert outcome.setpoints_after == 0, outcome.story
    assert outcome.on_time, outcome.story
    # SAF-015: this library does not delay the end of a caller.
    assert outcome.gone_ms <= GONE_MS


@pytest.mark.parametrize(
    ("victim", "fault", "spoilt"),
    [
        (Victims.CALLER, Faults.FREEZE, True),
        (Victims.WIRE, Faults.KILL, False),  # the root starts another wire
        ("standby", Faults.KILL, False),
        ("recorder", Faults.KILL, False),
        ("camera/eye", Faults.KILL, True),  # the pause before its restart becomes longer each time
        ("camera/eye", Faults.FREEZE, False),  # it is released afterwards
        ("spawner", Faults.KILL, True),
        ("standby/stop", Faults.KILL, True),
    ],
)
def test_a_tree_is_used_for_the_next_cell_only_if_it_is_complete_again(
    victim: str, fault: Faults, spoilt: bool
) -> None:
    assert spoils(victim, fault) is spoilt


def test_every_victim_and_fault_is_a_cell_or_has_a_reason_why_not() -> None:
    cells = list(cells_of(driver_of("robotiq_2f85"), ["host"]))
    assert {(cell.victim, cell.fault) for cell in cells} == {(v, f) for v in Victims for f in Faults}
    for cell in cells:
        assert bool(cell.why_not) != bool(cell.proves)
    why = {cell.why_not for cell in cells if cell.victim is Victims.POLICY and cell.fault is Faults.KILL}
    assert why == {driver_of("robotiq_2f85").ROLLOUTS}
