"""Sensors that a robot has, as its driver declares them: what is published on which topic, under
which field.

What is not declared is not published there; it still stands in ``health``. Field names are those of
the reference's subscribers (``rpy``, ``gyro``, ``accel``; ``pct``), so that a program written for
them reads every robot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

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


class Sensor(msgspec.Struct, frozen=True):
    """One topic. ``fields``: field on the topic -> name in ``Observation.sensors``."""

    topic: str
    fields: Mapping[str, str]

    def __post_init__(self) -> None:
        if self.topic not in TOPICS_HZ:
            raise ValueError(f"sensor: no topic {self.topic!r}. Use one of {', '.join(TOPICS_HZ)}")

    def read(self, sensors: Mapping[str, Row]) -> dict[str, float | list[float | None] | None]:
        """Return what the robot reports now, by field: a number, or a list of several; unknown
        numbers are None."""
        told: dict[str, float | list[float | None] | None] = {}
        for field, name in self.fields.items():
            row = sensors.get(name)
            if row is not None:
                known = [None if math.isnan(value) else value for value in row]
                told[field] = known[0] if len(known) == 1 else known
        return told
