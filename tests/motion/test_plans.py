"""``move_to`` plans a motion with a duration so that no gate of any robot refuses one of its steps, or
refuses it before it begins."""

from __future__ import annotations

import itertools
import math

import pytest
from msgspec.structs import replace

from strands_actors.caller.session.motions import (
    PEAK,
    Motion,
    RobotReading,
    minimum_jerk,
    plan_hold,
    plan_move,
    refuse_targets,
)
from strands_actors.contract.axis import AxisMode
from strands_actors.contract.driver import Driver, GateState
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from .robots import NOW_NS, drivers, observed

DRIVERS = drivers()
MOVED = [name for name, driver in DRIVERS.items() if refuse_targets(driver, {}) is None]
SHARE = 0.2
"""How far each joint is moved, as a share of its range."""


def targets_of(driver: Driver) -> dict[str, float]:
    """Return a target for every joint, away from its observed position."""
    found = {}
    for axis, here in zip(driver.table, observed(driver).position, strict=True):
        # "active" of a Microduck is 0 or 1, and no position.
        if axis.mode is AxisMode.POSITION and axis.key != "active":
            span = axis.high - axis.low
            found[axis.key] = here + (SHARE * span if math.isfinite(span) else 1.0)
    return found


def planned(driver: Driver, seconds: float) -> Motion | Refused:
    seen = observed(driver)
    period_s = 1 / driver.timing.control_hz
    return plan_move(
        driver, targets_of(driver), seconds, RobotReading(seen, driver.first_target(seen), NOW_NS), period_s
    )


def refusals(driver: Driver, motion: Motion) -> list[Refused]:
    """Return the refusals by the robot's gates of all steps, each checked at the time of its sending."""
    seen = observed(driver)
    target, found = driver.first_target(seen), []
    for step in range(1, motion.n_steps + 1):
        now_ns = NOW_NS + round(step * motion.period_s * NS)
        seen = replace(seen, t_ns=now_ns, stamp_ns=(now_ns,) * len(seen.stamp_ns))
        before_ns = now_ns - round(motion.period_s * NS)
        state = GateState(now_ns, seen, target, before_ns, True, motion.period_s)
        parsed = driver.parse(motion.action(step), state)
        assert not isinstance(parsed, Refused), parsed
        found += [refusal for gate in driver.gates if (refusal := gate(parsed, state)) is not None]
        target = parsed.values
        seen = replace(seen, position=target[: len(driver.axes)])
    return found


def test_most_robots_take_a_motion_in_a_time() -> None:
    left_out = set(DRIVERS) - set(MOVED)
    assert left_out == {
        name for name, driver in DRIVERS.items() if type(driver).__module__.split(".")[2] == "unitree"
    }


@pytest.mark.parametrize("robot", MOVED)
def test_a_motion_at_its_least_seconds_passes_every_gate(robot: str) -> None:
    driver = DRIVERS[robot]
    refused = planned(driver, 0.001)
    least_s = 0.2
    if any(math.isfinite(axis.speed) for axis in driver.table):
        assert isinstance(refused, Refused) and refused.code == "too_fast", refused
        least_s = float(refused.limit)
        assert f"give seconds={refused.limit}" in refused.remedy and refused.verb == "move_to"
        period_s = 1 / driver.timing.control_hz
        assert isinstance(planned(driver, max(0.001, least_s - 2 * period_s - 0.01)), Refused)
    motion = planned(driver, least_s)
    assert isinstance(motion, Motion), motion
    assert refusals(driver, motion) == []
    assert motion.action(motion.n_steps) == targets_of(driver)


@pytest.mark.parametrize("robot", ["so101", "ur5e", "kuka_iiwa"])
def test_the_path_is_smooth(robot: str) -> None:
    driver = DRIVERS[robot]
    motion = planned(driver, 3.0)
    assert isinstance(motion, Motion)
    key = driver.axes[0]
    path = [observed(driver).position[0], *(motion.action(step)[key] for step in range(1, motion.n_steps + 1))]
    steps = [then - before for before, then in itertools.pairwise(path)]
    way = path[-1] - path[0]
    assert min(steps) >= 0 and max(steps) <= PEAK * way / motion.n_steps * (1 + 1e-9)
    assert max(steps[0], steps[-1]) < max(steps) / 20, "the motion begins and ends at rest"
    assert motion.seconds == pytest.approx(3.0, abs=1 / driver.timing.control_hz)


def test_minimum_jerk_is_at_rest_at_both_ends() -> None:
    assert [minimum_jerk(share) for share in (0.0, 0.5, 1.0)] == [0.0, 0.5, 1.0]
    little = 1e-4
    assert minimum_jerk(little) < 1e-11 and 1 - minimum_jerk(1 - little) < 1e-11


@pytest.mark.parametrize(
    ("robot", "targets", "code"),
    [
        ("so101", {"shoulder_pan": 400.0}, "past_travel"),
        ("so101", {"elbow": 1.0}, "unknown_joint"),
        ("so101", {"gripper": math.nan}, "not_finite"),
        ("so101", {}, "empty"),
        ("stretch", {"lift": 0.4, "vx": 0.1}, "a_speed"),
        ("spot", {"vx.pos": 0.1}, "a_speed"),
        ("unitree_go2", {"FR_hip_joint": 0.1}, "keeps_no_pose"),
        ("panda", {"joint1": 0.1}, "not_all_joints"),
    ],
)
def test_an_unreachable_target_is_refused_before_the_motion_begins(
    robot: str, targets: dict[str, float], code: str
) -> None:
    driver, seen = DRIVERS[robot], observed(DRIVERS[robot])
    known = RobotReading(seen, driver.first_target(seen), NOW_NS)
    refused = refuse_targets(driver, targets) or plan_move(driver, targets, 2.0, known, 0.02)
    assert isinstance(refused, Refused) and refused.code == code, refused
    assert refused.verb == "move_to"


def test_a_joint_that_is_not_read_goes_nowhere() -> None:
    driver = DRIVERS["so101"]
    seen = observed(driver)
    unknown = replace(seen, position=(math.nan, *seen.position[1:]), stamp_ns=(0, *seen.stamp_ns[1:]))
    refused = plan_move(driver, {"shoulder_pan": 1.0}, 2.0, RobotReading(unknown, seen.position, NOW_NS), 0.03)
    assert isinstance(refused, Refused) and refused.code == "unknown_pose"


def test_an_earlier_target_that_is_far_ahead_is_held_first() -> None:
    driver = DRIVERS["so101"]
    seen = observed(driver)
    ahead = (seen.position[0] + 60.0, *seen.position[1:])
    for target, apart in ((seen.position, False), (ahead, True)):
        motion = plan_move(driver, {"shoulder_pan": 10.0}, 2.0, RobotReading(seen, target, NOW_NS), 1 / 30)
        assert isinstance(motion, Motion) and motion.begins_apart is apart


BASES = {
    "earthrover": {"linear": 0.5},
    "yahboom_m3pro": {"linear.x": 0.2, "linear.y": 0.0, "angular.z": 0.1},
    "stretch": {"vx": 0.1, "wz": 0.1},
    "spot": {"vx": 0.3, "vy": 0.0, "wz": 0.0},
    "crazyflie": {"vx": 0.2, "vy": 0.0, "vz": 0.0, "wz": 0.0},
}


@pytest.mark.parametrize("robot", BASES)
def test_a_held_speed_is_repeated_and_ends_with_an_explicit_zero(robot: str) -> None:
    driver, action = DRIVERS[robot], BASES[robot]
    seen = observed(driver)
    period_s = 1 / driver.timing.control_hz
    motion = plan_hold(driver, "move", action, 2.0, RobotReading(seen, driver.first_target(seen), NOW_NS), period_s)
    assert isinstance(motion, Motion), motion
    assert period_s <= 0.1 and motion.n_steps == math.ceil(2.0 / period_s) + 1
    assert all(motion.action(step) == action for step in range(1, motion.n_steps))
    assert motion.action(motion.n_steps) == dict.fromkeys(action, 0.0)


@pytest.mark.parametrize("robot", BASES)
def test_a_speed_that_is_too_high_is_refused_before_it_begins(robot: str) -> None:
    driver = DRIVERS[robot]
    seen = observed(driver)
    key = next(axis.key for axis in driver.table if axis.mode is AxisMode.VELOCITY)
    refused = plan_hold(
        driver, "move", {key: 99.0}, 2.0, RobotReading(seen, driver.first_target(seen), NOW_NS), 0.1
    )
    assert isinstance(refused, Refused) and refused.verb == "move", refused
