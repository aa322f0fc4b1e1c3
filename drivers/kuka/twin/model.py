"""Build the simulation model of a KUKA arm from its table in ``robots.toml``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strands_actors.drivers.common.kinematics.link_rows import with_limits
from strands_actors.drivers.kuka.robots import TABLES, Arm


def model_table(arm: Arm) -> Mapping[str, Any]:
    """Return the arm as a table from which ``drivers/common/physics/model_rows`` builds the model.

    Ranges, torques and speeds are copied from the joints.
    """
    table = TABLES.table(arm.name)
    joints = {joint.key: joint for joint in arm.joints}

    def limits_of(key: str) -> str:
        joint = joints[key]
        return f"{-joint.reach_rad},{joint.reach_rad} {joint.effort_nm} {joint.speed_rad_s}"

    rows = with_limits(table["links"], limits_of)
    return {**table, "joints": [{"key": key} for key in arm.axes], "model_rows": rows}
