"""SAF-016: two processes fail within 50 ms. Test the tables of the matrix of pairs and its short form.

Processes and wires are real. The bounds are the published ones, except that the time for which
processes waited for a processor is not counted. ``strands-actors matrix --pairs`` measures them.
"""

from __future__ import annotations

from itertools import permutations

import pytest

from strands_actors.supervisors.standby.watch import look_s, silent_s
from strands_actors.testing.bench import driver_of
from strands_actors.testing.faults import Faults, Victims
from strands_actors.testing.pair_trials import run_pair
from strands_actors.testing.pairs import (
    Combination,
    Pair,
    expected_safe_states,
    pair_bound_s,
    pair_named,
    pairs_of,
)
from strands_actors.testing.trials import cell_named

from .conftest import BenchOf

SETTLE_S = 0.2
ROBOTS = ("so101", "robotiq_2f85")
"""A serial bus, and a stop channel that connects when it is needed."""
ROLES = ("caller", "policy", "wire", "root", "standby", "spawner", "camera/eye", "recorder", "standby/stop")
CELLS = [
    (robot, pair)
    for robot in ROBOTS
    for pair in pairs_of(driver_of(robot), ROLES[:5])
    if not pair.why_not and (Victims.ROOT in pair.members or not pair.members)
]


@pytest.mark.quick_cases(10)
@pytest.mark.parametrize(("robot", "pair"), CELLS, ids=str)
def test_saf_016_two_processes_fail_and_the_wire_is_safe(robot: str, pair: Pair, bench_of: BenchOf) -> None:
    outcome = run_pair(pair, bench_of(robot), SETTLE_S)
    assert outcome.all_motors, f"no {outcome.safe_state} frame for all motors, but {outcome.story}"
    assert outcome.setpoints_after == 0, outcome.story
    assert outcome.on_time, outcome.story


def test_each_two_processes_in_each_way_are_a_pair_or_have_a_reason_why_not() -> None:
    pairs = list(pairs_of(driver_of("so101"), ROLES))
    for first, second in permutations(ROLES, 2):
        for way in (Combination.KILLS, Combination.FREEZES):
            assert any(set(pair.members) == {first, second} and pair.combination is way for pair in pairs)
        assert Pair((first, second), Combination.FREEZE_AND_KILL, "", ("SAF-002", "SAF-016")) in pairs
    assert len(pairs) == len(set(pairs)) == 36 + 72 + 36 + 1
    gripper = driver_of("robotiq_2f85")
    for pair in pairs_of(gripper, ROLES):
        assert pair.why_not == (gripper.ROLLOUTS if Victims.POLICY in pair.members else "")


@pytest.mark.parametrize("pair", [*pairs_of(driver_of("so101"), ROLES)], ids=str)
def test_a_pair_is_found_by_the_names_of_its_trials(pair: Pair) -> None:
    cell = cell_named(pair.victim, pair.fault)
    assert isinstance(cell, Pair) and (cell.members, cell.combination) == (pair.members, pair.combination)
    assert pair_named(pair.victim, pair.fault) == cell


def test_a_stop_outranks_a_hold_and_an_uninvolved_process_does_not_count() -> None:
    arm = driver_of("so101")

    def of(*members: str, way: Combination = Combination.FREEZES) -> tuple[tuple[str, ...], float]:
        pair = Pair(members, way)
        return expected_safe_states(arm, pair), round(pair_bound_s(arm, pair), 3)

    assert of(Victims.CALLER, Victims.POLICY) == (("hold",), 0.13)
    assert of(Victims.POLICY, Victims.WIRE) == (("limp",), 0.15)
    assert of(Victims.POLICY, "standby") == (("hold",), 0.13)
    assert of(Victims.ROOT, "standby") == (("limp",), 0.15)
    assert of(Victims.WIRE, "a kind that is new") == (("limp",), 0.15)
    assert of("standby", "spawner") == (("limp",), 0.05), "a stop ends the trial"
    assert of(Victims.POLICY, Victims.ROOT, way=Combination.FREEZE_AND_KILL) == (("limp",), 0.05)
    assert of(Victims.WIRE, Victims.ROOT, way=Combination.KILLS) == (("limp",), 0.05)
    both_s = round(0.05 + silent_s(arm.timing) + look_s(arm.timing), 3)
    assert of(Victims.WIRE, Victims.ROOT) == of(Victims.ROOT, Victims.WIRE) == (("limp",), both_s)
    assert of(way=Combination.PKILL) == (("limp",), 0.05)


def test_the_faults_of_a_pair_are_assigned_to_its_members() -> None:
    pair = Pair((Victims.ROOT, Victims.WIRE), Combination.FREEZE_AND_KILL)
    assert pair.faults == ((Victims.ROOT, Faults.FREEZE), (Victims.WIRE, Faults.KILL))
    assert f"{pair}" == "root+wire-freeze+kill"
