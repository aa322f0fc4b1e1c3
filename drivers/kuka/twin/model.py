"""The model of the arm behind the twin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strands_actors.drivers.kuka.robots import TABLES, Arm


def model_table(arm: Arm) -> Mapping[str, Any]:
    """Return the arm as ``drivers/common/model_rows`` takes it: range, effort and speed come from
    the joints."""
    table = TABLES.table(arm.name)
    joints = {joint.key: joint for joint in arm.joints}
    rows = []
    for line in table["links"].splitlines():
        if not line.strip():
            continue
        body, parent, key, axis, xyz, rot, kg, com, geom = line.split()
        joint = joints[key]
        limits = f"{-joint.reach_rad},{joint.reach_rad} {joint.effort_nm} {joint.speed_rad_s}"
        rows.append(f"{body} {parent} {key} {axis} {xyz} {rot} {limits} {kg} {com} {geom}")
    return {**table, "joints": [{"key": key} for key in arm.axes], "model_rows": "\n".join(rows)}
