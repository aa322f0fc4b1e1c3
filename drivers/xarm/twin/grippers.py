"""The simulated arm with a gripper on its flange, and the motion of the gripper in the physics of the arm."""

from __future__ import annotations

from strands_actors.drivers.common.physics.fingers import FingerJoints, PhysicalFingers, motorise
from strands_actors.drivers.common.physics.hand_motion import HandMotion
from strands_actors.drivers.common.physics.model_rows import build
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.xarm.arms import AXES, ArmType, model_table
from strands_actors.drivers.xarm.grippers import FINGERS, GRIPPER, TRAVEL_M

JOINTS = FingerJoints(
    motor=FINGERS[0],
    followers=FINGERS[1:],
    open=TRAVEL_M,
    closed=0.0,
    effort=30.0,
    stiffness=2000.0,
    damping=60.0,
    inertia=0.3,
)
"""The largest force, 30 N, is that of the vendor's data sheet. Gains and inertia are [assumed]."""


def plant_of(robot: str, arm_type: ArmType, gripper: str) -> Plant:
    """Return the simulated arm, with a gripper on its flange if ``gripper`` is not empty."""
    table = model_table(robot, arm_type, gripper)
    spec = build(table)
    if gripper == GRIPPER:
        motorise(spec, JOINTS)
    return Plant(spec, AXES, float(table["bandwidth"]), table["home_rad"])


def hand_of(gripper: str, plant: Plant) -> HandMotion | None:
    """Return the motion of a gripper with physics; None for any other."""
    return HandMotion(PhysicalFingers(plant, JOINTS)) if gripper == GRIPPER else None
