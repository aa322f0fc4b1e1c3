"""SAF-002, SAF-003, SAF-004: a robot that a host keeps is as safe as the robot of a script.

Its host is one more process that may fail.

``strands-actors matrix --drivers so101:hosted`` measures all cells.
"""

from __future__ import annotations

import pytest

from strands_actors.contract.driver import Reason
from strands_actors.testing import Cell, Faults, Victims, cells_of, run_cell
from strands_actors.testing.bench import driver_of
from strands_actors.testing.faults import expected_safe_states

from .conftest import BenchOf

COLUMN = "so101:hosted"
CELLS = [
    (Victims.HOST, Faults.KILL),
    (Victims.HOST, Faults.FREEZE),
    (Victims.CALLER, Faults.KILL),
    (Victims.CALLER, Faults.FREEZE),
    (Victims.WIRE, Faults.KILL),
    (Victims.ROOT, Faults.KILL),
]


@pytest.mark.long
@pytest.mark.parametrize(("victim", "fault"), CELLS)
def test_saf_003_a_process_of_a_hosted_robot_fails_and_the_wire_is_safe(
    victim: Victims, fault: Faults, bench_of: BenchOf
) -> None:
    outcome = run_cell(Cell(victim, fault), bench_of(COLUMN), 0.2)
    assert outcome.safe, outcome.story
    assert outcome.on_time, outcome.story


def test_the_end_of_an_attached_caller_is_a_lost_writer() -> None:
    driver = driver_of(COLUMN)
    for fault in (Faults.KILL, Faults.EXIT, Faults.FREEZE):
        expected = (driver.fallbacks[Reason.LEASE],)
        assert expected_safe_states(driver, Victims.CALLER, fault, hosted=True) == expected
    assert expected_safe_states(driver, Victims.HOST, Faults.FREEZE) == (driver.fallbacks[Reason.CALLER],)


def test_only_a_hosted_robot_has_cells_of_a_host() -> None:
    driver = driver_of(COLUMN)
    assert not [cell for cell in cells_of(driver) if cell.victim is Victims.HOST]
    faults = {cell.fault for cell in cells_of(driver, ["host"]) if cell.victim is Victims.HOST and not cell.why_not}
    assert faults == {Faults.KILL, Faults.FREEZE}
