"""Read the supported Robotiq grippers from ``robots.toml``."""

from __future__ import annotations

from strands_actors.drivers.common.kit.hand import FULL
from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Robotiq")

UNIT = 9
"""Modbus unit of a gripper on delivery [instruction manual]."""


def speed_percent_s(gripper: str) -> float:
    """Return the top speed of the fingers in percent of their stroke per second."""
    table = TABLES.table(gripper)
    return float(FULL * table["speed_mm_s"][1] / table["stroke_mm"])
