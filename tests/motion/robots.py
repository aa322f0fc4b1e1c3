"""Make every robot's driver, and a reading with which its gates let the robot move."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.contract.axis import Axis, AxisMode
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.contract.wire import Observation
from strands_actors.drivers import WIRES

NOW_NS = 10_000_000_000

SENSORS: Mapping[str, Mapping[str, tuple[float, ...]]] = {
    "UR": {"speed_scaling": (1.0,)},
    "Robotiq": {"activation": (3.0,), "fault": (0.0,)},
    "Stretch": {"homed": (1.0,) * 9, "wheel_watchdog": (1.0,)},
    "BoosterDriver": {"fall_state": (0.0, 1e9), "motors": (29.0,), "upper_body": (1.0,)},
}
"""Sensor values that gates read, by the driver's class."""

TELL_THEIR_LIMITS = ("XArm", "RBY1")


def drivers() -> dict[str, Driver]:
    """Return one driver for each built-in robot."""
    found: dict[str, Driver] = {}
    for where in WIRES.values():
        made_by: type[Driver] = load(where)
        for robot in made_by.SUPPORTED_ROBOTS:
            found[robot] = made_by(robot, "", made_by.resolve(robot, {}))
    return found


def middle(axis: Axis) -> float:
    """Return a value of the axis with room on both sides."""
    if axis.mode is AxisMode.VELOCITY:
        return axis.rest
    return 0.0 if axis.low == -axis.high or axis.low == -float("inf") else (axis.low + axis.high) / 2


def observed(driver: Driver, now_ns: int = NOW_NS) -> Observation:
    """Return a reading of a robot in the middle of its ranges."""
    sensors = dict(SENSORS.get(type(driver).__name__, {}))
    if type(driver).__name__ in TELL_THEIR_LIMITS:
        sensors["range_low_rad"] = tuple(axis.low for axis in driver.table)
        sensors["range_high_rad"] = tuple(axis.high for axis in driver.table)
        sensors["speed_limit_rad_s"] = tuple(axis.speed for axis in driver.table)
    position = tuple(middle(axis) for axis in driver.table)
    return Observation(now_ns, position, (now_ns,) * len(position), (), sensors)
