"""Read the robots with Feetech servos from ``robots.toml``."""

from __future__ import annotations

from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Feetech")

LEADERS = RobotTables(__package__, "Feetech", TABLES)
"""The leader arms of these robots: ``leaders.toml``."""
