"""Build the simulated body of a robot from its table in ``robots.toml``."""

from __future__ import annotations

from strands_actors.drivers.common.kinematics.link_rows import with_limits
from strands_actors.drivers.common.physics.legged_body import LeggedBody
from strands_actors.drivers.unitree.robots import TABLES, Model


def body_of(model: Model) -> LeggedBody:
    """Return the simulated body. Its joint limits, torques and speeds come from the joints in the table."""
    table = TABLES.table(model.name)
    joints = {joint.key: joint for joint in model.joints}

    def limits_of(key: str) -> str:
        joint = joints[key]
        return f"{joint.low},{joint.high} {joint.torque} {joint.speed}"

    return LeggedBody({**table, "model_rows": with_limits(table["links"], limits_of)}, model.axes)
