"""Read the supported Kinova robots from ``robots.toml``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from strands_actors.contract.loading import load
from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Kinova")

LAST_LINK, INTERFACE_M = "bracelet", 0.0615
"""The last link, and the distance from its joint to the face of the interface, as in the vendor's URDF."""

Gripper = Literal["robotiq_2f85"]
"""The grippers that the interface can carry as one more axis."""

MOUNTED = "strands_actors.drivers.robotiq.mounted"
INTERFACE = "interface"
"""Name of the link that carries a gripper. Its axis z points away from the arm."""


def model_table(robot: str, gripper: str = "") -> Mapping[str, Any]:
    """Return the table of an arm, with the links of a gripper on its interface if ``gripper`` is not empty."""
    table = TABLES.table(robot)
    if not gripper:
        return table
    row = f"{INTERFACE} {LAST_LINK} - - 0,0,{-INTERFACE_M} 180,0,0 - - - .01 - -"
    with_gripper: dict[str, Any] = load(f"{MOUNTED}:with_gripper")(
        {**table, "model_rows": f"{table['model_rows']}\n{row}"}, INTERFACE, gripper
    )
    return with_gripper
