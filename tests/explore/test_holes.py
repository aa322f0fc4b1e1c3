"""The explorer finds each bug of ``holes.py`` when the bug is put back."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.explorer.plan import plan_of
from tests.explorer.search import run_apart
from tests.explorer.shrink import shrink

from . import holes

FOUND: dict[tuple[Callable[[pytest.MonkeyPatch], None], str], tuple[int, str]] = {
    (holes.a_stop_writes_nothing_on_a_lost_link, "so101"): (532, "SAF-020 an order to stop is written"),
    (holes.a_resume_is_obeyed_while_the_tree_ends, "so101"): (315, "SAF-018 nothing stays energised"),
    (holes.a_hold_takes_readings_of_any_age, "so101"): (3, "SAF-019 a hold moves no joint"),
    (holes.a_goal_goes_to_motors_without_torque, "so101"): (914, "SAF-019 no frame energises a limp motor"),
    (holes.a_stop_of_a_task_beside_a_dead_wire_ends_the_root, "so101"): (
        675,
        "SAF-003 no process fails by itself",
    ),
    (holes.a_task_begins_after_its_deadline, "fake_base"): (733, "SAF-010 no task begins that failed to start"),
    (holes.a_lock_ends_with_the_script, "so101"): (8, "SAF-018 a lock is obeyed"),
    (holes.a_policy_can_be_the_gate, "fake_base"): (465, "SAF-008 nothing is energised without a resume"),
    (holes.a_velocity_goes_on_that_nobody_names, "fake_base"): (1, "SAF-014 what is not named rests"),
    (holes.a_fault_takes_the_place_of_an_estop, "fake_drone"): (216, "SAF-007 an e-stop is carried out as ordered"),
    (holes.nobody_looks_at_the_robot_itself, "fake_drone"): (56, "SAF-003 a condition is obeyed"),
    (holes.a_lock_ends_with_the_script, "fake_http"): (1891, "SAF-018 a lock is obeyed"),
    (holes.a_stop_of_a_controller_is_not_read_back, "xarm7"): (1, "SAF-005 what is confirmed is so"),
    (holes.a_stop_needs_the_connection_of_the_wire, "xarm7"): (43, "SAF-018 nothing stays energised"),
    (holes.legs_are_told_to_let_go_once, "unitree_go2"): (17, "SAF-005 what is confirmed is so"),
    (holes.the_root_has_not_found_the_legs, "unitree_go2"): (9, "SAF-015 a tree ends"),
    (holes.nobody_waits_for_what_was_asked_before, "ur5e"): (146, "SAF-021 nothing takes effect after a stop"),
    (holes.nobody_waits_for_what_was_asked_before, "ur5e_script"): (
        139,
        "SAF-021 nothing takes effect after a stop",
    ),
    (holes.nobody_waits_for_what_was_asked_before, "fake_queue"): (2, "SAF-021 nothing takes effect after a stop"),
    (holes.a_root_that_does_not_answer_has_stopped_the_robot, "so101"): (34, "SAF-023 a success is true"),
    (holes.a_hold_of_a_lost_robot_is_confirmed, "fake_base"): (91, "SAF-023 a success is true"),
    (holes.a_hold_of_a_lost_robot_is_confirmed, "so101"): (60, "SAF-023 a success is true"),
    (holes.a_process_stays_that_cannot_stop_the_robot, "xarm7"): (
        191,
        "SAF-024 an exhausted process is no obstacle",
    ),
    (holes.a_permit_forgets_deadlines, "ur5e"): (76, "SAF-001 no setpoint past its deadline"),
    (holes.a_stop_waits_before_its_first_frame, "rby1"): (3, "SAF-020 an order to stop is written"),
    (holes.a_stop_waits_before_its_first_frame, "spot"): (58, "SAF-020 an order to stop is written"),
    (holes.a_stop_waits_before_its_first_frame, "yahboom_m3pro"): (7, "SAF-020 an order to stop is written"),
    (holes.a_stop_waits_before_its_first_frame, "earthrover"): (17, "SAF-020 an order to stop is written"),
    (holes.a_stop_waits_before_its_first_frame, "crazyflie"): (2, "SAF-020 an order to stop is written"),
    (holes.answers_move_an_arm_until_its_stop_begins, "kuka_iiwa"): (2, "SAF-020 an order to stop is written"),
    (holes.a_stop_waits_before_its_first_frame, "booster_t1"): (24, "SAF-020 an order to stop is written"),
    (holes.a_stop_waits_before_its_first_frame, "microduck"): (20, "SAF-020 an order to stop is written"),
    (holes.a_stop_waits_before_its_first_frame, "reachy_mini"): (19, "SAF-020 an order to stop is written"),
    (holes.a_stop_waits_before_its_first_frame, "kinova_gen3"): (19, "SAF-020 an order to stop is written"),
    (holes.a_stop_waits_before_its_first_frame, "robotiq_2f85"): (5, "SAF-020 an order to stop is written"),
    (holes.a_stop_waits_before_its_first_frame, "stretch3"): (2, "SAF-020 an order to stop is written"),
    (holes.commands_move_an_arm_until_its_stop_begins, "panda"): (42, "SAF-020 an order to stop is written"),
}
"""For each bug, a seed below 2 000 that finds it (mostly the first), and the promise that it breaks."""


@pytest.mark.parametrize(("hole", "robot"), FOUND, ids=[f"{hole.__name__}-{robot}" for hole, robot in FOUND])
def test_a_hole_that_is_put_back_is_found(
    hole: Callable[[pytest.MonkeyPatch], None], robot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    seed, invariant = FOUND[hole, robot]
    plan = plan_of(seed, robot)
    (whole,) = run_apart([plan])
    assert not whole.violations, "the run without the bug must keep its promises"
    hole(monkeypatch)
    (result,) = run_apart([plan])
    assert invariant in [violation.invariant for violation in result.violations]


def test_a_failing_run_is_made_shorter(monkeypatch: pytest.MonkeyPatch) -> None:
    hole = holes.a_resume_is_obeyed_while_the_tree_ends
    seed, invariant = FOUND[hole, "so101"]
    hole(monkeypatch)
    plan = shrink(plan_of(seed, "so101"), invariant)
    assert {event.kind for event in plan.events} <= {"cleanup", "kill", "restart", "resume"}
    (result,) = run_apart([plan])
    assert [violation.invariant for violation in result.violations] == [invariant]
