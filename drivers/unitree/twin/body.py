"""Build the twin's body from the robot's table."""

from __future__ import annotations

from strands_actors.drivers.common.physics.legged_body import LeggedBody
from strands_actors.drivers.common.physics.model_rows import with_limits
from strands_actors.drivers.unitree.robots import TABLES, Model


def body_of(model: Model) -> LeggedBody:
    """Return the body. Limits, torque and speed come from the joints, the rest from ``links``."""
    table = TABLES.table(model.name)
    joints = {joint.key: joint for joint in model.joints}

    def limits_of(key: str) -> str:
        joint = joints[key]
        return f"{joint.low},{joint.high} {joint.torque} {joint.speed}"

    return LeggedBody({**table, "model_rows": with_limits(table["links"], limits_of)}, model.axes)
