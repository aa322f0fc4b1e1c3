"""Encode the state that a controller sends on its script ports without a request. Pure: no I/O, no clock.

The layout is that of controllers with software 5.10 or later, big-endian. The primary and secondary port (30001 and
30002) send ``i32 size | u8 kind | parts``, and each part is ``i32 size | u8 kind | data``. The real-time port
(30003) sends ``i32 size`` and 152 doubles.
"""

from __future__ import annotations

import struct

from strands_actors.drivers.ur import protocol as p

from .controller import Controller
from .outputs import MAIN_V, ROBOT_V, ROOM_C, TOOL_MODE_IDLE, Sample

ROBOT_STATE, ROBOT_MESSAGE = 16, 20
MESSAGE_VERSION, MESSAGE_KEY = 3, 7
SOURCE_CONTROLLER = -2

PROJECT, VERSION, BUILT = b"URControl", (5, 13, 1, 0), b"21-11-2023, 00:00:00"

JOINT_ACCELERATION_RAD_S2, EQUIVALENT_RADIUS_M = 40.0, 0.3
"""Values of the configuration and kinematics that the simulated controller reports [assumed]."""

_MODE = struct.Struct(">Q7?BBdddB")
_JOINT = struct.Struct(">dddffffB")
_TOOL = struct.Struct(">bbddfBffB")
_MASTERBOARD = struct.Struct(">iibbddbbddffffBBbIBBB")
_CARTESIAN = struct.Struct(">12d")
_KINEMATICS = struct.Struct(">6I24dI")
_CONFIGURATION = struct.Struct(">12d12d5d24d4i")
_REALTIME = struct.Struct(">i152d")

_ALPHA_RAD = (1.570796327, 0.0, 0.0, 1.570796327, -1.570796327, 0.0)


def version_message() -> bytes:
    """Return the message with the controller's version, which ports 30001 and 30002 send first."""
    major, minor, bugfix, build = VERSION
    head = struct.pack(">QbbB", 0, SOURCE_CONTROLLER, MESSAGE_VERSION, len(PROJECT))
    return _part(ROBOT_MESSAGE, head + PROJECT + struct.pack(">BBii", major, minor, bugfix, build) + BUILT)


def error_message(uptime_s: float, text: str) -> bytes:
    """Encode a line of the controller's own log as a message for the clients of ports 30001 and 30002."""
    title = b"Error"
    head = struct.pack(">QbbiiB", round(uptime_s * 1e6), SOURCE_CONTROLLER, MESSAGE_KEY, 0, 0, len(title))
    return _part(ROBOT_MESSAGE, head + title + text.encode("ascii", "replace"))


def state_message(controller: Controller, sample: Sample) -> bytes:
    """Encode the present state for ports 30001 and 30002."""
    return _part(
        ROBOT_STATE,
        _part(0, _mode(controller))
        + _part(1, _joints(sample))
        + _part(4, _CARTESIAN.pack(*_six(sample["actual_TCP_pose"]), *controller.tcp.pose()))
        + _part(5, _kinematics(controller))
        + _part(6, _configuration(controller))
        + _part(3, _masterboard(controller))
        + _part(2, _TOOL.pack(0, 0, 0.0, 0.0, ROBOT_V, controller.tool_voltage, 0.0, ROOM_C, TOOL_MODE_IDLE))
        + _part(7, struct.pack(">7d", *([0.0] * 7)))
        + _part(8, struct.pack(">BBBB", 0, controller.motion.limp, 0, 0))
        + _part(11, struct.pack(">Biiiff", 0, 115200, 0, 1, 1.5, 3.5))
        + _part(12, struct.pack(">BBB", 0, 0, 0)),
    )


def realtime_message(controller: Controller, sample: Sample) -> bytes:
    """Encode the present state for the real-time port, 30003."""
    six = [0.0] * 6
    target, velocity = _six(sample["target_q"]), _six(sample["actual_qd"])
    current, torque = _six(sample["actual_current"]), _six(sample["target_moment"])
    pose, speed = _six(sample["actual_TCP_pose"]), _six(sample["actual_TCP_speed"])
    numbers = (
        *(sample["timestamp"], *target, *velocity, *six, *current, *torque),
        *(*_six(sample["actual_q"]), *velocity, *current, *current, *pose, *speed, *six, *pose, *speed),
        *(0.0, *([ROOM_C] * 6), 0.5, 0.0, float(controller.mode), *_six(sample["joint_mode"])),
        *(float(controller.safety), *six, 0.0, 0.0, 0.0, *six, sample["speed_scaling"], 0.0, 0.0, 0.0),
        *(MAIN_V, ROBOT_V, 0.0, *([ROBOT_V] * 6), float(controller.digital_out), float(controller.runtime_state)),
        *(*_six(sample["elbow_position"]), 0.0, 0.0, 0.0, float(controller.safety), 0.0, 0.0, 0.0),
        *(controller.payload_kg, *controller.payload_cog_m, *controller.payload_inertia),
    )
    return _REALTIME.pack(_REALTIME.size, *numbers)


def _mode(controller: Controller) -> bytes:
    safety, powered = controller.safety, controller.mode >= p.RobotMode.POWER_ON
    stopped = safety in (p.SafetyMode.SYSTEM_EMERGENCY_STOP, p.SafetyMode.ROBOT_EMERGENCY_STOP)
    state = controller.runtime_state
    return _MODE.pack(
        round(controller.uptime_s * 1e6),
        True,  # A robot is connected.
        True,  # It is a real robot.
        powered,
        stopped,
        safety is p.SafetyMode.PROTECTIVE_STOP,
        state is p.RuntimeState.PLAYING,
        state is p.RuntimeState.PAUSED,
        max(0, int(controller.mode)),
        0,
        controller.speed_slider,
        0.0 if controller.paused else 1.0,
        1.0,
        0,
    )


def _joints(sample: Sample) -> bytes:
    rows = zip(
        _six(sample["actual_q"]),
        _six(sample["target_q"]),
        _six(sample["actual_qd"]),
        _six(sample["actual_current"]),
        _six(sample["joint_mode"]),
        strict=True,
    )
    return b"".join(
        _JOINT.pack(actual, target, speed, current, ROBOT_V, ROOM_C, ROOM_C, int(mode))
        for actual, target, speed, current, mode in rows
    )


def _masterboard(controller: Controller) -> bytes:
    first, second = controller.analog_out
    types = controller.analog_types
    return _MASTERBOARD.pack(
        *(0, controller.digital_out, 0, 0, 0.0, 0.0, types & 1, types >> 1 & 1, first, second),
        *(ROOM_C, ROBOT_V, 0.0, 0.0, int(controller.safety), controller.safety is p.SafetyMode.REDUCED, 0, 0),
        *(0, 0, 0),
    )


def _dh(controller: Controller) -> tuple[float, ...]:
    """Return the DH parameters a, d and alpha, each for all joints."""
    d1, a2, a3, d4, d5, d6 = controller.arm.dh_m
    return (0.0, a2, a3, 0.0, 0.0, 0.0, d1, 0.0, 0.0, d4, d5, d6, *_ALPHA_RAD)


def _kinematics(controller: Controller) -> bytes:
    return _KINEMATICS.pack(*([0] * 6), *([0.0] * 6), *_dh(controller), 0)


def _configuration(controller: Controller) -> bytes:
    axes = controller.arm.axes
    ranges = [number for axis in axes for number in (axis.low, axis.high)]
    speeds = [number for axis in axes for number in (axis.speed, JOINT_ACCELERATION_RAD_S2)]
    defaults = (1.05, 1.4, 0.25, 1.2, EQUIVALENT_RADIUS_M)
    return _CONFIGURATION.pack(*ranges, *speeds, *defaults, *_dh(controller), *([0.0] * 6), 0, 1, 0, 0)


def _part(part_type: int, data: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(data), part_type) + data


def _six(value: p.Value) -> tuple[float, ...]:
    assert isinstance(value, tuple)
    return value
