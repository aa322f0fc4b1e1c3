"""Test that the generator keeps the arm's limits as its controller computes them: from differences of
successive commands."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from strands_actors.drivers.franka.arms import HOME_RAD, JOINTS, Arm, arm_of, arms
from strands_actors.drivers.franka.generator import STEP_S, Limits, Trajectory, limits_of

SLACK = 1e-6
MOST_STEPS = 120_000


def goals(limits: Limits) -> st.SearchStrategy[tuple[float, ...]]:
    return st.tuples(*(st.floats(low, high) for low, high in zip(limits.low, limits.high, strict=True)))


def differences(rows: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    pairs = itertools.pairwise(rows)
    return [tuple((after - before) / STEP_S for before, after in zip(*pair, strict=True)) for pair in pairs]


def check_limits(arm: Arm, factor: float, path: list[tuple[float, ...]]) -> None:
    speeds = differences(path)
    accelerations = differences(speeds)
    jerks = differences(accelerations)
    for joint in range(JOINTS):
        assert all(arm.low[joint] - SLACK <= row[joint] <= arm.high[joint] + SLACK for row in path)
        assert max(abs(row[joint]) for row in speeds) <= arm.speed[joint] * factor + SLACK
        most = arm.acceleration[joint] * factor
        assert max(abs(row[joint]) for row in accelerations) <= most * (1 + SLACK) + 1e-4
        assert max(abs(row[joint]) for row in jerks) <= arm.jerk[joint] * factor * (1 + SLACK) + 0.1
        for before, row, speed in zip(path, path[1:], speeds, strict=False):
            for rad in (before[joint], row[joint]):
                slowest, fastest = arm.speed_at(joint, rad)
                assert slowest - SLACK <= speed[joint] <= fastest + SLACK, (joint, rad, speed[joint])


def run(trajectory: Trajectory, path: list[tuple[float, ...]]) -> None:
    for _ in range(MOST_STEPS):
        if trajectory.arrived:
            return
        path.append(trajectory.step())
    raise AssertionError("it does not arrive")


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("robot", arms())
@pytest.mark.parametrize("factor", [0.2, 1.0])
@settings(max_examples=5, deadline=None)
@given(data=st.data())
def test_from_rest_to_rest(robot: str, factor: float, data: st.DataObject) -> None:
    arm = arm_of(robot)
    limits = limits_of(arm, factor)
    goal = data.draw(goals(limits))
    trajectory, path = Trajectory(limits, HOME_RAD), [HOME_RAD] * 4
    trajectory.aim(goal)
    run(trajectory, path)
    path += [path[-1]] * 4
    assert path[-1] == pytest.approx(goal, abs=1e-8)
    check_limits(arm, factor, path)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("robot", arms())
@pytest.mark.parametrize("factor", [0.2, 1.0])
@settings(max_examples=5, deadline=None)
@given(data=st.data())
def test_goals_that_change_while_it_moves(robot: str, factor: float, data: st.DataObject) -> None:
    arm = arm_of(robot)
    limits = limits_of(arm, factor)
    trajectory, path = Trajectory(limits, HOME_RAD), [HOME_RAD] * 4
    for goal, steps in data.draw(st.lists(st.tuples(goals(limits), st.integers(1, 400)), min_size=2, max_size=5)):
        trajectory.aim(goal)
        path += [trajectory.step() for _ in range(steps)]
    run(trajectory, path)
    check_limits(arm, factor, path)


@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_it_brakes_at_once_and_stays(data: st.DataObject) -> None:
    arm = arm_of("panda")
    limits = limits_of(arm, 1.0)
    trajectory, path = Trajectory(limits, HOME_RAD), [HOME_RAD] * 4
    trajectory.aim(data.draw(goals(limits)))
    path += [trajectory.step() for _ in range(data.draw(st.integers(1, 1500)))]
    fastest = max(map(abs, differences(path)[-1]))
    trajectory.brake()
    braked = len(path)
    run(trajectory, path)
    longest_s = max(fastest / most for most in limits.acceleration) + 0.02
    assert (len(path) - braked) * STEP_S <= longest_s
    check_limits(arm, 1.0, path + [path[-1]] * 4)


def test_joints_begin_and_arrive_together_on_a_straight_line() -> None:
    limits = limits_of(arm_of("panda"), 0.2)
    goal = [rad + 0.1 * (number + 1) for number, rad in enumerate(HOME_RAD)]
    trajectory, path = Trajectory(limits, HOME_RAD), [HOME_RAD]
    trajectory.aim(goal)
    run(trajectory, path)
    for row in path[50:-50]:
        shares = [(rad - start) / (end - start) for rad, start, end in zip(row, HOME_RAD, goal, strict=True)]
        assert max(shares) - min(shares) < 0.01
    assert math.isclose(path[-1][0], goal[0])


def test_a_goal_where_it_is_needs_no_step() -> None:
    trajectory = Trajectory(limits_of(arm_of("fr3"), 0.2), HOME_RAD)
    assert trajectory.arrived
    trajectory.aim(HOME_RAD)
    assert trajectory.arrived


@pytest.mark.parametrize("robot", arms())
def test_the_window_keeps_the_jerk_of_every_arm(robot: str) -> None:
    arm = arm_of(robot)
    for acceleration, jerk in zip(arm.acceleration, arm.jerk, strict=True):
        assert 2 * acceleration / (4 * STEP_S) <= jerk * (1 + 1e-9)
