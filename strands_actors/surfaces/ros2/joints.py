"""Convert between the units of a robot's driver and those of ROS (REP-103): radians, metres, metres per second.

The driver of a robot is known by the robot's type, which is in its presence message. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from strands_actors.contract.axis import Axis, AxisMode, PartKind
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.contract.sensors import Sensor
from strands_actors.drivers import get_native_driver_class

from .tool_pose import PoseOf, pose_function

SCALES: Mapping[str, float] = {"rad": 1.0, "deg": 180.0 / math.pi, "m": 1.0, "mm": 1000.0}
"""The number of each unit that is one radian or one metre."""

TWIST_AXES: Mapping[str, tuple[str, str]] = {
    "vx": ("linear", "x"),
    "vy": ("linear", "y"),
    "vz": ("linear", "z"),
    "wz": ("angular", "z"),
    "vyaw": ("angular", "z"),
    "linear.x": ("linear", "x"),
    "linear.y": ("linear", "y"),
    "angular.z": ("angular", "z"),
}
"""The component of geometry_msgs/msg/Twist for each axis of a base. An axis counts only with an SI unit."""
LEAST_PERIOD_S = 0.02
"""A robot accepts at most 100 commands a second from the mesh, from all programs together."""
UNIT_ENDINGS = ("_rad", "_rad_s", "_m", "_m_s", "_m_s2", "_wxyz", "_pct", "_v", "_n_nm")
"""The ends of sensors' names that state a unit which is converted here. A robot's raw numbers have no such end."""
_SPEED_UNITS = ("m/s", "rad/s")


class Joint(NamedTuple):
    """A joint, and how its numbers are converted.

    ``value = zero + scale * position``, where the value is in the driver's unit, and the position in radians,
    metres, or, for a gripper of unknown geometry, as the fraction that the driver uses.
    """

    key: str
    zero: float
    scale: float

    def position(self, value: float) -> float:
        return (value - self.zero) / self.scale

    def velocity(self, value: float) -> float:
        return value / self.scale

    def value(self, position: float) -> float:
        return self.zero + self.scale * position


class Gripper(NamedTuple):
    """A gripper with one axis.

    Attributes:
        joint: Its joint.
        span: The distance between its ends, in the unit of the joint's position.
        speed: Its greatest speed in this unit per second, or one span per second if the driver states none.
        least_s: The shortest duration of a motion, in seconds.
    """

    joint: Joint
    span: float
    speed: float
    least_s: float = 0.3


class Layout(NamedTuple):
    """The joints and the base of one type of robot.

    Attributes:
        joints: The joints that can be commanded, and those that are only read.
        commanded: The keys of the joints that can be commanded.
        twist: For each component of a twist, the key of the axis that takes it. Empty without a base.
        stale_s: A reading that is older than this many seconds is not published.
        lifetime_s: How long a command of a stream is valid, in seconds.
        period_s: The period of the setpoints of a planned motion, in seconds.
        fields: For each topic of a sensor, its fields with a known unit.
        link_rows: The links of the robot; empty if the driver does not have them.
        grippers: The grippers with one axis.
        tool: Computes the pose of the tool from the positions of the joints; None if it is unknown.
    """

    joints: tuple[Joint, ...]
    commanded: frozenset[str]
    twist: Mapping[tuple[str, str], str]
    stale_s: float
    lifetime_s: float
    period_s: float
    fields: Mapping[str, frozenset[str]]
    link_rows: str = ""
    grippers: tuple[Gripper, ...] = ()
    tool: PoseOf | None = None


def layout_of(robot_type: str, keys: Sequence[str]) -> Layout | None:
    """Return the layout of a robot.

    Args:
        robot_type: The type of the robot, as in its presence message.
        keys: The keys of its axes, as in its presence message.

    Returns:
        None if no driver on this computer has this type and these axes. The units are then unknown.
    """
    for driver in _drivers(robot_type):
        if tuple(driver.axes) == tuple(keys):
            return read_driver(driver)
    return None


def _drivers(robot_type: str) -> Iterator[Driver]:
    driver_class = get_native_driver_class(robot_type)
    if not isinstance(driver_class, type) or not issubclass(driver_class, Driver):
        return
    levels = [load(place) for name, place in driver_class.LEVELS.items() if name.partition(":")[0] == robot_type]
    for each in (driver_class, *levels):
        try:
            driver = each(robot_type, "", each.resolve(robot_type, {}))
        except (TypeError, ValueError):
            continue  # A driver of another package may need options that are not known here.
        yield driver


def read_driver(driver: Driver) -> Layout:
    """Return the layout that a driver declares."""
    joints: list[Joint] = []
    twist: dict[tuple[str, str], str] = {}
    grippers: list[Gripper] = []
    units = dict(zip(driver.axes, driver.model_units(), strict=True))
    for part in driver.parts:
        for axis in part.axes:
            if axis.mode is AxisMode.VELOCITY:
                if axis.unit in _SPEED_UNITS and axis.key in TWIST_AXES:
                    twist[TWIST_AXES[axis.key]] = axis.key
            elif part.kind is not PartKind.DRONE:
                of_axis = list(_joint(axis, part.kind, units[axis.key]))
                joints += of_axis
                if part.kind is PartKind.GRIPPER and len(part.axes) == 1:
                    grippers += [_gripper(axis, joint) for joint in of_axis]
    commanded = frozenset(joint.key for joint in joints)
    joints += [Joint(each.key, 0.0, SCALES[each.unit]) for each in driver.READ_ONLY_JOINTS if each.unit in SCALES]
    timing = driver.timing
    fields = {sensor.topic: _fields(sensor) for sensor in driver.SENSORS}
    return Layout(
        tuple(joints),
        commanded,
        twist,
        max(timing.state_ttl_s, 1.0),
        timing.stream_ttl_s,
        min(timing.stream_ttl_s / 3, max(1.0 / timing.control_hz, LEAST_PERIOD_S)),
        fields,
        driver.link_rows(),
        tuple(grippers),
        pose_function(driver),
    )


def _gripper(axis: Axis, joint: Joint) -> Gripper:
    span, speed = (axis.high - axis.low) / abs(joint.scale), axis.speed / abs(joint.scale)
    return Gripper(joint, span, speed if math.isfinite(speed) else span)


def _fields(sensor: Sensor) -> frozenset[str]:
    """Return the fields of a topic for which the sensor's name has a unit, such as ``gyro_rad_s``."""
    return frozenset(
        field for field, source in sensor.fields.items() if source.partition("[")[0].endswith(UNIT_ENDINGS)
    )


def _joint(axis: Axis, part: PartKind, unit: tuple[float, float]) -> Iterator[Joint]:
    """Yield the joint of an axis, if its unit can be converted.

    A gripper in percent is converted by the driver's model. A gripper whose driver knows no angle keeps its
    fraction.
    """
    if axis.unit in SCALES:
        yield Joint(axis.key, 0.0, SCALES[axis.unit])
    elif unit != (0.0, 1.0) or part is PartKind.GRIPPER:
        yield Joint(axis.key, *unit)
