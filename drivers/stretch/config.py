"""Settings of a Stretch, shared by the process that drives it (the wire) and the supervising process (root), which
can also stop it."""

from __future__ import annotations

import math

import msgspec

from strands_actors.drivers.common.servo.axes import Axis as ServoAxis
from strands_actors.drivers.common.servo.config import ServoConfig

from .parameters import Chain, Motor, Parameters
from .protocol import Command, Mode

BAUD = 115_200
"""Rate of the boards' ports. They are USB, where it has no meaning."""

LEFT, RIGHT, LIFT, ARM, PIMU = "left_wheel", "right_wheel", "lift", "arm", "pimu"
STEPPERS = (LEFT, RIGHT, LIFT, ARM)
BOARDS = (*STEPPERS, PIMU)
BASE = ("vx", "wz")

TICKS_PER_S = 0.229 * 4096 / 60
"""Unit of a Dynamixel's velocity register."""
TICKS_PER_S2 = 214.577 * 4096 / 3600
"""Unit of its profile acceleration: 214.577 turns/min2."""


class StretchConfig(msgspec.Struct, frozen=True):
    robot: str
    parameters: Parameters
    timeout_s: float = 0.5
    """The link counts as lost when a board is silent for so long."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the keys of the axes that have a position, in their order."""
        chains = (self.parameters.wrist, self.parameters.head)
        return (LIFT, ARM, *(joint.key for chain in chains for joint in chain.joints))

    @property
    def axes(self) -> tuple[str, ...]:
        return (*self.joints, *BASE)

    @property
    def motors(self) -> dict[str, Motor]:
        p = self.parameters
        return {LEFT: p.left, RIGHT: p.right, LIFT: p.lift, ARM: p.arm}

    def usb(self, board: str) -> str:
        return self.parameters.pimu_usb if board == PIMU else self.motors[board].usb

    @property
    def chains(self) -> tuple[Chain, Chain]:
        return self.parameters.wrist, self.parameters.head

    def chain_config(self, chain: Chain) -> ServoConfig:
        """Return the settings of one chain of Dynamixel servos."""
        return ServoConfig(
            robot=self.robot,
            port=chain.usb,
            baud=chain.baud,
            joints=tuple(
                ServoAxis(
                    key=joint.key,
                    id=joint.id,
                    # The servo model differs from robot to robot.
                    model="",
                    unit="rad",
                    zero=joint.zero,
                    scale=joint.scale,
                    low=joint.low_t,
                    high=joint.high_t,
                    speed=joint.speed_rad_s,
                )
                for joint in chain.joints
            ),
            calibration=None,
            calibration_source="the robot's YAML",
            timeout_s=self.timeout_s,
            others=chain.others,
        )

    # -- units

    def wheels(self, vx: float, wz: float) -> tuple[float, float]:
        """Convert a twist of the base to the speeds of the left and the right wheel, m/s."""
        turn = wz * self.parameters.separation_m / 2
        return vx - turn, vx + turn

    def twist(self, left_m_s: float, right_m_s: float) -> tuple[float, float]:
        return (left_m_s + right_m_s) / 2, (right_m_s - left_m_s) / self.parameters.separation_m

    # -- commands

    def goal(self, joint: str, position_m: float) -> Command:
        """Return the command that moves lift or arm to a position, with the motion profile of the YAML."""
        motor = self.motors[joint]
        return _guarded(motor, Mode.POSITION_PROFILE)._replace(
            position=position_m * motor.rad_per_m,
            velocity=motor.speed_m_s * motor.rad_per_m,
            acceleration=motor.acceleration_m_s2 * motor.rad_per_m,
        )

    def drive(self, wheel: str, speed_m_s: float) -> Command:
        motor = self.motors[wheel]
        return _guarded(motor, Mode.VELOCITY_PROFILE)._replace(
            velocity=speed_m_s * motor.rad_per_m,
            acceleration=motor.acceleration_m_s2 * motor.rad_per_m,
        )

    def hold(self, board: str) -> Command:
        """Return the command that holds a stepper where it is."""
        return _guarded(self.motors[board], Mode.HOLD)

    def stand(self, wheel: str) -> Command:
        """Return the command that stops a wheel at once, without a motion profile."""
        return _guarded(self.motors[wheel], Mode.VELOCITY)


def _guarded(motor: Motor, mode: Mode) -> Command:
    positive, negative = motor.contact_a
    return Command(mode=mode, feedforward_a=motor.feedforward_a, contact_pos_a=positive, contact_neg_a=negative)


def ticks_per_s(rad_s: float, gear: float) -> int:
    """Convert a joint speed to the units of a Dynamixel's profile velocity. The result is at least 1, because
    zero means unlimited."""
    return max(1, int(rad_s * gear * 4096 / math.tau / TICKS_PER_S))


def ticks_per_s2(rad_s2: float, gear: float) -> int:
    return max(1, int(rad_s2 * gear * 4096 / math.tau / TICKS_PER_S2))
