"""Sensors that a robot has, as its driver declares them: what is published on which topic, under
which field.

What is not declared is not published there; it still stands in ``health``. Field names are those of
the reference's subscribers (``rpy``, ``gyro``, ``accel``; ``pct``), so that a program written for
them reads every robot.
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
    "battery": 0.5,
    "lidar/summary": 5.0,
    "lidar/state": 1.0,
}
"""The topics that a sensor may be published on, and how often they are."""

Row = tuple[float, ...]


def number_of(sensors: Mapping[str, Row], name: str, missing: int = -1) -> int:
    """Return a sensor that is one whole number (a mode, a state); ``missing``: the robot has not
    told it."""
    row = sensors.get(name)
    return round(row[0]) if row and math.isfinite(row[0]) else missing


class ReadOnlyJoint(msgspec.Struct, frozen=True):
    """A joint that the robot reports and that nobody here moves. ``sensor``: the name in
    ``Observation.sensors`` of the one number that is its position; ``unit``: what that counts."""

    key: str
    sensor: str
    unit: str


class Sensor(msgspec.Struct, frozen=True):
    """One topic. ``fields``: field on the topic -> name in ``Observation.sensors``; ``name[0]`` is
    one number of a row. ``prefix``: whatever sensors begin so are fields too, for a driver that
    learns only from its robot what it has. ``words``: fields that never change (``frame``)."""

    topic: str
    fields: Mapping[str, str] = {}
    prefix: str = ""
    words: Mapping[str, str] = {}

    def __post_init__(self) -> None:
        if self.topic not in TOPICS_HZ:
            raise ValueError(f"sensor: no topic {self.topic!r}. Use one of {', '.join(TOPICS_HZ)}")

    def publishes(self, name: str) -> bool:
        """Return whether a sensor is on this topic, and so need not stand in ``health``."""
        whole = (source.partition("[")[0] for source in self.fields.values())
        return name in whole or bool(self.prefix and name.startswith(self.prefix))

    def read(self, sensors: Mapping[str, Row]) -> dict[str, Any]:
        """Return what the robot reports now, by field: a number, or a list of several; unknown
        numbers are None. Empty when nothing of it was read."""
        told: dict[str, Any] = {}
        for name, row in sensors.items() if self.prefix else ():
            if name.startswith(self.prefix):
                told[name.removeprefix(self.prefix)] = _known(row)
        for field, source in self.fields.items():
            name, _, at = source.partition("[")
            row = sensors.get(name, ())
            if not at and name in sensors:
                told[field] = _known(row)
            elif at and int(at[:-1]) < len(row):
                told[field] = _known(row[int(at[:-1]) :][:1])
        return {**told, **self.words} if told else {}


def _known(row: Row) -> float | list[float | None] | None:
    known = [None if math.isnan(value) else value for value in row]
    return known[0] if len(known) == 1 else known


def imu(**sensors: str) -> Sensor:
    """Return the topic ``imu``. ``sensors``: of ``rpy``, ``gyro``, ``accel`` and ``quaternion``
    those that the robot has. Subscribers of strands-robots read ``gyroscope`` and ``accelerometer``
    of some robots, ``gyro`` and ``accel`` of others: both are there."""
    other = {"gyro": "gyroscope", "accel": "accelerometer"}
    more = {other[field]: name for field, name in sensors.items() if field in other}
    return Sensor("imu", {**sensors, **more})


def pose(xyz: str, *, rpy: str = "", frame: str, **more: str) -> Sensor:
    """Return the topic ``pose`` of a row of three positions: ``x``, ``y``, ``z`` and ``xyz``; of a
    row of three angles ``rpy`` and ``theta``, the turn about z."""
    fields = {"xyz": xyz, "x": f"{xyz}[0]", "y": f"{xyz}[1]", "z": f"{xyz}[2]", **more}
    if rpy:
        fields |= {"rpy": rpy, "theta": f"{rpy}[2]"}
    return Sensor("pose", fields, words={"frame": frame})
