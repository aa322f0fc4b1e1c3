"""The twin's body, from the robot's table."""

from __future__ import annotations

from strands_actors.drivers.common.legged_body import LeggedBody
from strands_actors.drivers.unitree.robots import TABLES, Model


def body_of(model: Model) -> LeggedBody:
    """Limits, torque and speed come from the joints, the rest from ``links``."""
    table = TABLES.table(model.name)
    joints = {joint.key: joint for joint in model.joints}
    rows = []
    for line in table["links"].splitlines():
        if not line.strip():
            continue
        body, parent, key, axis, xyz, rot, kg, com, geom = line.split()
        joint = joints[key]
        limits = f"{joint.low},{joint.high} {joint.torque} {joint.speed}"
        rows.append(f"{body} {parent} {key} {axis} {xyz} {rot} {limits} {kg} {com} {geom}")
    return LeggedBody({**table, "model_rows": "\n".join(rows)}, model.axes)
