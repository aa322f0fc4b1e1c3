"""The measurements of the simulated arm, as ``BaseCyclic.Feedback``."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kinova import protocol as p
from strands_actors.drivers.kinova.protocol import ArmState, Feedback

from . import messages as m
from .arm import Arm
from .gripper import Gripper
from .kinematics import Kinematics, numbers_of

FRAMES_HZ = 1000
"""Control cycles per second. Each cycle has a new measurement and a frame number."""

SUPPLY_V, SUPPLY_A, ROOM_C, AMPERE_PER_NM = 24.0, 1.0, 30.0, 0.1
"""Values for the simulated measurements of supply, temperature and current [assumed]."""

WRONG_RAD = 0.5
"""The fault ``wrong`` falsifies each angle by this much."""


class Readings:
    def __init__(self, arm: Arm, gripper: Gripper | None, kinematics: Callable[[], Kinematics]) -> None:
        self._arm = arm
        self._gripper = gripper
        self._kinematics = kinematics
        self._frozen: Feedback | None = None

    def freeze(self, feedback: Feedback | None) -> None:
        """Repeat this feedback from now on. None: measure again."""
        self._frozen = feedback

    def measure(self, state: ArmState, fault_bank: int, frame: int, wrong: bool) -> Feedback:
        """Measure the arm.

        Args:
            state: The state of the base.
            fault_bank: Its faults.
            frame: The number of the control cycle.
            wrong: True to falsify the angles.
        """
        if self._frozen is not None:
            return self._frozen
        plant = self._arm.plant
        position = [rad + WRONG_RAD * wrong for rad in plant.position_rad]
        rows = zip(position, plant.velocity_rad_s, self._arm.effort_nm, self._arm.faults, strict=True)
        actuators = tuple(
            p.Actuator(
                math.degrees(rad) % 360.0,
                math.degrees(rad_s),
                -nm,  # The vendor's example of torque control says that the measured torque is reversed.
                nm * AMPERE_PER_NM,
                ROOM_C,
                ROOM_C,
                (bank, 0),
            )
            for rad, rad_s, nm, bank in rows
        )
        x, y, z = self._kinematics().pose(position).m.tolist()
        return Feedback(state, actuators, SUPPLY_V, (x, y, z), (fault_bank, 0), frame)

    def pose(self, feedback: Feedback) -> tuple[float, ...]:
        """Return the pose of the tool: x, y, z in metres and the angles in degrees."""
        return numbers_of(self._kinematics().pose(_radians(feedback)))

    def encode(self, feedback: Feedback) -> bytes:
        """Encode a feedback with all its fields."""
        kinematics = self._kinematics()
        pose, jacobian = kinematics.jacobian(_radians(feedback))
        speeds = np.radians([joint.velocity_deg_s for joint in feedback.actuators])
        twist = jacobian @ speeds
        twist[3:] = np.degrees(twist[3:])
        commanded = numbers_of(kinematics.pose(self._arm.target))
        of_base = (
            m.floats((SUPPLY_A, ROOM_C, ROOM_C), 4)
            + m.floats(numbers_of(pose)[3:], 16)
            + m.floats(twist.tolist(), 19)
            + m.floats(commanded, 35)
        )
        interface = m.floats((SUPPLY_V, ROOM_C), 10)
        if self._gripper is not None and not self._gripper.lost:
            interface += pb.bytes_field(18, self._gripper.feedback())
        return feedback.encode(of_base, pb.bytes_field(4, interface))


def _radians(feedback: Feedback) -> list[float]:
    return [math.radians(joint.position_deg) for joint in feedback.actuators]
