"""The registers of the control port that the simulated controller models, and the settings that it stores."""

from __future__ import annotations

from typing import NamedTuple

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.xarm.protocol import Mode, Register

CHECK_JOINTS, REPORT_CURRENTS = 45, 70
"""Whether joint positions are out of range; and whether reports have currents instead of torques."""

MODES = (Mode.POSITION, Mode.SERVO, Mode.VELOCITY)

ANSWER_SIZE = 40
"""Bytes of zeros in the answer to an invalid request. The vendor's client decodes the answer of a read even if the
state byte says "invalid", so an empty answer would end the client with an exception [assumed]."""


class Setting(NamedTuple):
    """A setting that clients write into a register, and read in the reports."""

    name: str
    size: int  # of the data of the request, in bytes
    place: int  # in a report, in bytes from its start


SETTINGS: dict[int, Setting] = {
    31: Setting("tool jerk", 4, 181),
    32: Setting("highest tool acceleration", 4, 189),
    33: Setting("joint jerk", 4, 201),
    34: Setting("highest joint acceleration", 4, 209),
    35: Setting("tool offset", 24, 91),
    36: Setting("payload and its centre", 16, 115),
    37: Setting("collision sensitivity", 1, 131),
    38: Setting("teaching sensitivity", 1, 132),
    51: Setting("direction of gravity", 12, 133),
}

REGISTERS: Modelled[int] = Modelled(
    "registers of the control port",
    {
        Register.VERSION: "returns the version text",
        Register.SERIAL: "returns the serial number",
        Register.MOTION_ENABLE: "switches motors on or off; without power the brakes hold",
        Register.SET_STATE: "0 readies the arm, 3 pauses it, 4 stops it; other numbers are invalid",
        Register.GET_STATE: "returns the state",
        Register.QUEUE: "returns the number of queued motions",
        Register.ERRORS: "returns error and warning",
        Register.CLEAR_ERROR: "removes the error",
        Register.CLEAR_WARNING: "removes the warning",
        Register.SET_MODE: "0 position, 1 servo or 4 velocity, and stops the arm; other modes are invalid",
        Register.MOVE_JOINT: "queues a joint motion; only in mode 0; error 23 out of range",
        Register.MOVE_HOME: "queues a motion of all joints to zero; only in mode 0",
        Register.SERVO_JOINT: "moves to joint positions; only in mode 1; error 23 out of range, 24 for a jump",
        Register.TCP_POSE: "returns the pose of the flange",
        Register.JOINT_STATES: "returns positions, speeds and torques of the joints",
        CHECK_JOINTS: "returns whether joint positions are out of range",
        Register.JOINT_TORQUE: "returns the torques of the joints",
        REPORT_CURRENTS: "accepts 0, torques; invalid for currents",
        Register.JOINT_VELOCITY: "turns the joints at speeds; only in mode 4",
        **{register: f"stores the {setting.name}; the reports show it" for register, setting in SETTINGS.items()},
    },
    'the bit "invalid" (0x08) in the state byte',
)
