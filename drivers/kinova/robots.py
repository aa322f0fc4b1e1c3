"""Read the supported Kinova robots from ``robots.toml``."""

from __future__ import annotations

from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Kinova")

LAST_LINK, INTERFACE_M = "bracelet", 0.0615
"""The last link, and the distance from its joint to the face of the interface, as in the vendor's URDF."""
