"""Read the robots of this driver from ``robots.toml``."""

from __future__ import annotations

from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "EarthRover")
