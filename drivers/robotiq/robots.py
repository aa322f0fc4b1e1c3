"""Read the supported Robotiq grippers from ``robots.toml``."""

from __future__ import annotations

from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Robotiq")

UNIT = 9
"""Modbus unit of a gripper on delivery [instruction manual]."""
