"""The sensors of a robot, as its driver declares them: their topics and fields.

A sensor that is not declared is not published on a topic, but is still in ``health``. Fields have the names that
subscribers of strands-robots use (``rpy``, ``gyro``, ``accel``; ``pct``). So a program that reads strands-robots'
topics can read every robot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec

TOPICS_HZ: Mapping[str, float] = {
    "pose": 10.0,
    "imu": 10.0,
    "odom": 10.0,
    "wrench": 10.0,
    "battery": 0.5,
    "lidar/summary": 5.0,
    "lidar/state": 1.0,
}
"""The topics of sensors, with their rates in Hz."""

Row = tuple[float, ...]


def number_of(sensors: Mapping[str, Row], name: str, missing: int = -1) -> int:
    """Return the value of a sensor that has one whole number, such as a mode or a state.

    Args:
        sensors: The sensors of an observation, by name.
        name: The name of the sensor.
        missing: The value to return if the robot has not reported the sensor.
    """
    row = sensors.get(name)
    return round(row[0]) if row and math.isfinite(row[0]) else missing


class ReadOnlyJoint(msgspec.Struct, frozen=True):
    """A joint that the robot reports, but that cannot be commanded.

    Attributes:
        key: The name of the joint.
        sensor: The name of the sensor in ``Observation.sensors`` that contains the joint's position.
        unit: The unit of the position.
    """

    key: str
    sensor: str
    unit: str


class Sensor(msgspec.Struct, frozen=True):
    """The content of one topic.

    Attributes:
        topic: One of ``TOPICS_HZ``.
        fields: The fields of the topic, and for each the name in ``Observation.sensors``. ``name[0]`` is the first
            number of a sensor with several numbers.
        prefix: Every sensor with this prefix is a field, too, for a driver that learns its sensors from the
            robot.
        words: Fields that never change (``frame``).
    """

    topic: str
    fields: Mapping[str, str] = {}
    prefix: str = ""
    words: Mapping[str, str] = {}

    def __post_init__(self) -> None:
        if self.topic not in TOPICS_HZ:
            raise ValueError(f"sensor: no topic {self.topic!r}. Use one of {', '.join(TOPICS_HZ)}")

    def publishes(self, name: str) -> bool:
        """Return True if this topic has the sensor ``name``. The topic ``health`` then leaves the sensor out."""
        whole = (source.partition("[")[0] for source in self.fields.values())
        return name in whole or bool(self.prefix and name.startswith(self.prefix))

    def read(self, sensors: Mapping[str, Row]) -> dict[str, Any]:
        """Return the present readings by field; empty if nothing was read.

        A reading is a number, or a list of numbers. Unknown numbers are None.

        Args:
            sensors: ``Observation.sensors``.
        """
        readings: dict[str, Any] = {}
        for name, row in sensors.items() if self.prefix else ():
            if name.startswith(self.prefix):
                readings[name.removeprefix(self.prefix)] = _without_nan(row)
        for field, source in self.fields.items():
            name, _, index = source.partition("[")
            row = sensors.get(name, ())
            if not index and name in sensors:
                readings[field] = _without_nan(row)
            elif index and int(index[:-1]) < len(row):
                readings[field] = _without_nan(row[int(index[:-1]) :][:1])
        return {**readings, **self.words} if readings else {}


def _without_nan(row: Row) -> float | list[float | None] | None:
    values = [None if math.isnan(value) else value for value in row]
    return values[0] if len(values) == 1 else values


def imu(**sensors: str) -> Sensor:
    """Return the topic ``imu``.

    Subscribers of strands-robots read ``gyroscope`` and ``accelerometer`` from some robots, ``gyro`` and
    ``accel`` from others. Both names are published.

    Args:
        sensors: The name in ``Observation.sensors`` of each sensor that the robot has. Keys are ``rpy``, ``gyro``,
            ``accel`` and ``quaternion``.
    """
    other_names = {"gyro": "gyroscope", "accel": "accelerometer"}
    more = {other_names[field]: name for field, name in sensors.items() if field in other_names}
    return Sensor("imu", {**sensors, **more})


def pose(xyz: str, *, rpy: str = "", frame: str, **more: str) -> Sensor:
    """Return the topic ``pose``.

    Args:
        xyz: The sensor with three positions, published as ``xyz``, ``x``, ``y`` and ``z``.
        rpy: The sensor with three angles, published as ``rpy``, and as ``theta``, the rotation about z.
        frame: The name of the coordinate frame.
        more: Further fields of the topic, and for each the name in ``Observation.sensors``.
    """
    fields = {"xyz": xyz, "x": f"{xyz}[0]", "y": f"{xyz}[1]", "z": f"{xyz}[2]", **more}
    if rpy:
        fields |= {"rpy": rpy, "theta": f"{rpy}[2]"}
    return Sensor("pose", fields, words={"frame": frame})
