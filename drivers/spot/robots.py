"""Load the Spots that this driver supports, and translate joint names between this driver and the
robot's messages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strands_actors.contract.axis import Axis, AxisMode, Part, PartKind
from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Spot")

BASE = ("vx", "vy", "wz")
ARM = ("arm_sh0", "arm_sh1", "arm_el0", "arm_el1", "arm_wr0", "arm_wr1")
CLAW = "arm_f1x"
KEYS = (*BASE, *ARM, CLAW)
LEGS = tuple(f"{leg}_{joint}" for leg in ("fl", "fr", "hl", "hr") for joint in ("hx", "hy", "kn"))
LEG_SENSORS = {key: f"{key}_rad" for key in LEGS}
"""Sensors of the legs. They are read only: the robot's own controller walks."""

DRIVES, MOVES_ARM, MOVES_CLAW = len(KEYS), len(KEYS) + 1, len(KEYS) + 2
"""Indices of the flags behind the axes of a setpoint. A flag is 1 if its part gets a command."""


def wire_name(key: str) -> str:
    """Return the name of a joint in Spot's messages: ``arm0.sh0`` for ``arm_sh0``, ``fl.hx`` for
    ``fl_hx``."""
    return key.replace("arm_", "arm0.").replace("_", ".")


def parts_of(table: Mapping[str, Any]) -> tuple[Part, ...]:
    """Return the parts of a robot: base, arm and claw."""
    speeds = {"vx": table["vx_m_s"], "vy": table["vy_m_s"], "wz": table["wz_rad_s"]}
    base = tuple(
        Axis(
            key=key,
            unit="rad/s" if key == "wz" else "m/s",
            low=-float(limit),
            high=float(limit),
            mode=AxisMode.VELOCITY,
            id=number,
        )
        for number, (key, limit) in enumerate(speeds.items(), 1)
    )
    joints = tuple(
        Axis(key=key, unit="rad", low=low, high=high, speed=float(table["arm_rad_s"]), id=number, optional=True)
        for number, (key, (low, high)) in enumerate(table["joints_rad"].items(), len(base) + 1)
    )
    return Part(PartKind.BASE, base), Part(PartKind.ARM, joints[:-1]), Part(PartKind.GRIPPER, joints[-1:])
