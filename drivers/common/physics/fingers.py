"""The fingers of a hand in the physics of an arm: one motor, and joints that the mechanics turn or push with it."""

from __future__ import annotations

from typing import Any, NamedTuple

from .jointed import Jointed
from .lean_mujoco import PLAIN, mujoco

STIFF = {"solref": [0.004, 1.0], "solimp": [0.99, 0.999, 0.001, 0.5, 2.0]}
"""How stiffly the mechanics couple the joints."""

BEHIND, STILL_PER_S = 0.03, 0.02
"""The fingers press an object if they are so far behind the motor, and slower, in shares of the travel."""


class FingerJoints(NamedTuple):
    """The joints of the fingers of a hand.

    Attributes:
        motor: The joint with the motor.
        followers: The joints that have the same position.
        open: Position of an open hand, in metres or radians.
        closed: Position of a closed hand.
        effort: Largest force or torque of the motor, in N or N m.
        stiffness: Gain of the motor, in N/m or N m/rad.
        damping: Damping of the motor.
        inertia: Reflected inertia of each joint, in kg or kg m2.
    """

    motor: str
    followers: tuple[str, ...]
    open: float
    closed: float
    effort: float
    stiffness: float
    damping: float
    inertia: float


def motorise(spec: Any, joints: FingerJoints) -> None:
    """Give the fingers in the model of an arm their motor, and the mechanics that couple them."""
    for name in (joints.motor, *joints.followers):
        spec.joint(name).armature = joints.inertia
    for name in joints.followers:
        spec.add_equality(
            default=PLAIN.default,
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            name=f"{name}_follows",
            name1=name,
            name2=joints.motor,
            data=[0.0, 1.0, *[0.0] * 10],
            **STIFF,
        )
    motor = spec.add_actuator(name=joints.motor, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joints.motor)
    motor.set_to_position(kp=joints.stiffness, kv=joints.damping)
    motor.forcelimited = True
    motor.forcerange = [-joints.effort, joints.effort]


class PhysicalFingers:
    """The fingers of a hand, as ``hand_motion.Fingers``: 0 is open and 1 closed."""

    def __init__(self, physics: Jointed, joints: FingerJoints) -> None:
        self._physics, self._joints = physics, joints
        self._travel = joints.closed - joints.open

    @property
    def closed(self) -> float:
        return (float(self._physics.data.joint(self._joints.motor).qpos[0]) - self._joints.open) / self._travel

    def is_blocked(self, goal: float) -> bool:
        still = abs(float(self._physics.data.joint(self._joints.motor).qvel[0]) / self._travel) < STILL_PER_S
        return still and goal - self.closed > BEHIND

    def follow(self, goal: float, force: float) -> None:
        model, joints = self._physics.model, self._joints
        limit = joints.effort * force
        index = model.actuator(joints.motor).id
        model.actuator_forcerange[index] = -limit, limit
        self._physics.data.ctrl[model.actuator_ctrladr[index]] = joints.open + goal * self._travel


__all__ = ["FingerJoints", "PhysicalFingers", "motorise"]
