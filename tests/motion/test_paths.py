"""``move_along`` plans a given path so that no gate refuses one of its steps, or refuses it before it
begins."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace
from typing import Any

import pytest
import trio

from strands_actors.caller.handle import moving
from strands_actors.caller.session.motions import Motion, RobotReading
from strands_actors.caller.session.paths import Path, check_along, plan_along, read_path
from strands_actors.contract.axis import AxisMode
from strands_actors.contract.driver import Driver
from strands_actors.kernel.messages import Refused

from .robots import NOW_NS, drivers, observed
from .test_plans import refusals

DRIVERS = drivers()
HZ = 30.0
SWING_S = 4.0
SHARE = 0.01
"""How far each axis swings, as a share of its range or of its top speed."""

LEFT_OUT = {
    "crazyflie": ("z",),  # it takes either a height or a climbing speed
    "microduck": ("vx", "vy", "vyaw", "active"),  # it walks only in a mode that it reports; active is 0 or 1
}


def swings(driver: Driver) -> list[dict[str, float]]:
    """Return a path that swings every axis around its observed position."""
    rows = []
    for number in range(round(SWING_S * HZ)):
        wave = math.sin(math.tau * number / HZ / SWING_S)
        row = {}
        for axis, here in zip(driver.table, observed(driver).position, strict=True):
            span = axis.high - axis.low if math.isfinite(axis.high - axis.low) else 1.0
            if axis.key not in LEFT_OUT.get(driver.robot, ()):
                row[axis.key] = here + SHARE * span * wave
        rows.append(row)
    return rows


def seen_of(driver: Driver) -> RobotReading:
    seen = observed(driver)
    return RobotReading(seen, driver.first_target(seen), NOW_NS)


def planned(driver: Driver, rows: Any, hz: float = HZ) -> Motion | Refused:
    """Plan a path as ``move_along`` does. Return the motion, or the first refusal of a step."""
    path = read_path(driver, rows, hz)
    if isinstance(path, Refused):
        return path
    motion = plan_along(driver, path, seen_of(driver), 1 / driver.timing.control_hz)
    if isinstance(motion, Refused):
        return motion
    return next(filter(None, check_along(driver, motion, path, seen_of(driver))), motion)


MOVED = [name for name, driver in DRIVERS.items() if isinstance(read_path(driver, swings(driver), HZ), Path)]


def test_all_robots_but_those_that_keep_no_pose_go_along_a_path() -> None:
    left_out = {type(DRIVERS[name]).__module__.split(".")[2] for name in set(DRIVERS) - set(MOVED)}
    assert left_out == {"unitree"}


@pytest.mark.parametrize("robot", MOVED)
def test_a_path_passes_every_gate_and_ends_where_it_should(robot: str) -> None:
    driver, rows = DRIVERS[robot], swings(DRIVERS[robot])
    motion = planned(driver, rows)
    assert isinstance(motion, Motion), motion
    assert refusals(driver, motion) == []
    last = motion.action(motion.n_steps)
    for axis in driver.table:
        if axis.key in last:
            is_speed = axis.mode is AxisMode.VELOCITY
            assert last[axis.key] == pytest.approx(axis.rest if is_speed else rows[-1][axis.key])


def test_a_path_goes_to_the_first_row_and_in_straight_lines_from_row_to_row() -> None:
    driver = DRIVERS["so101"]
    motion = planned(driver, [{"shoulder_pan": 10.0}, {"shoulder_pan": 20.0}, {"shoulder_pan": 15.0}], hz=1.0)
    assert isinstance(motion, Motion) and motion.keeps
    assert motion.seconds == pytest.approx(2.0 + 2.0, abs=0.1)
    path = [motion.action(step)["shoulder_pan"] for step in range(1, motion.n_steps + 1)]
    rows = [path.index(value) for value in (10.0, 20.0)]
    assert rows[1] - rows[0] == pytest.approx(1 / motion.period_s, abs=1) and path[-1] == 15.0
    steps = {round(then - before, 6) for before, then in itertools.pairwise(path[rows[0] : rows[1]])}
    assert len(steps) == 1, "all steps have the same size"


def test_a_first_row_that_is_far_away_takes_the_time_that_it_needs() -> None:
    driver = DRIVERS["ur5e"]
    keys = driver.axes
    here = dict(zip(keys, observed(driver).position, strict=True))
    motion = planned(driver, [{**here, keys[0]: here[keys[0]] + 6.0}], hz=HZ)
    assert isinstance(motion, Motion) and motion.seconds > 2.5
    assert refusals(driver, motion) == []


def test_a_speed_is_sent_unchanged_and_zero_follows_the_last() -> None:
    driver = DRIVERS["earthrover"]
    motion = planned(driver, [{"linear": 0.2}, {"linear": 0.4}], hz=2.0)
    assert isinstance(motion, Motion) and not motion.keeps
    path = [motion.action(step)["linear"] for step in range(1, motion.n_steps + 1)]
    steps = round(0.5 / motion.period_s)
    assert path == [*[0.2] * steps, *[0.4] * steps, 0.0], "each row lasts half a second"


@pytest.mark.parametrize(
    ("rows", "hz", "code", "says"),
    [
        ([], HZ, "bad_path", "no list of rows"),
        ({"shoulder_pan": 1.0}, HZ, "bad_path", "no list of rows"),
        ([{}], HZ, "bad_path", "no list of rows"),
        ([{"shoulder_pan": 1.0}], 0.0, "bad_path", "hz is 0.0"),
        ([{"shoulder_pan": 1.0}], math.nan, "bad_path", "hz is nan"),
        ([{"shoulder_pan": 1.0}] * 7000, 10.0, "bad_path", "it takes 699.9 s"),
        ([{"shoulder_pan": 1.0}, {"gripper": 1.0}], HZ, "bad_path", "row 1 names other joints"),
        (
            [{"shoulder_pan": 1.0}, {"shoulder_pan": math.nan}],
            HZ,
            "bad_path",
            "row 1 has no number for shoulder_pan",
        ),
        ([{"elbow": 1.0}], HZ, "unknown_joint", "no joint 'elbow'"),
        ([{"shoulder_pan": 400.0}], HZ, "past_travel", "shoulder_pan 400"),
        ([{"shoulder_pan": 0.0}, {"shoulder_pan": 200.0}], 0.5, "past_travel", "at 1."),
        ([{"shoulder_pan": 0.0}, {"shoulder_pan": 60.0}], HZ, "too_fast", "at 0.03 s: shoulder_pan steps"),
    ],
)
def test_an_invalid_path_for_this_robot_is_refused(rows: Any, hz: float, code: str, says: str) -> None:
    refused = planned(DRIVERS["so101"], rows, hz)
    assert isinstance(refused, Refused) and refused.code == code, refused
    assert says in refused.reason and refused.remedy and refused.verb == "move_along"


def test_a_path_of_a_robot_that_was_not_armed_is_not_checked_before_it_begins() -> None:
    """Such a robot has a reading, but no target. The motion itself is refused."""
    driver = DRIVERS["so101"]
    path = read_path(driver, swings(driver), HZ)

    async def status() -> SimpleNamespace:
        return SimpleNamespace(observation=observed(driver), target=())

    tree: Any = SimpleNamespace(driver=driver, status=status)
    assert isinstance(path, Path)
    assert trio.run(moving._refuse_along, tree, path, 0.02) is None
