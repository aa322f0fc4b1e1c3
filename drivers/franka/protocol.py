"""Encode and decode FCI frames of the versions 5 (FER, "panda") and 10 (FR3).

Requests and replies use TCP, states and commands UDP. Pure: bytes in, values out. Everything is little-endian
and packed. Matrices are column-major. Sources: the published headers of libfranka-common for both versions. The
offsets were checked with numbered values against panda-python 1.1.1 and pylibfranka 0.21.3.
"""

from __future__ import annotations

import enum
import math
import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import msgspec

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

PORT = 1337
STATE_HZ = 1000
MISSED_TICKS = 20
"""With so many missing commands in a row the controller ends a motion.

The vendor's overview has ">= 20 packets", and its page on the network both "after 20 dropped packets" and "more
than 20 in a row". The twin takes the strictest."""

HEADER = struct.Struct("<III")
LARGEST_NUMBER = 100.0
"""Larger than the position or speed of any joint of any arm (rad, rad/s)."""

LARGEST_REQUEST = 4096
LARGEST_REPLY = 4096
"""Most bytes of a reply to our requests. A model library or description has megabytes, but we never request one."""


class RobotMode(enum.IntEnum):
    OTHER = 0
    IDLE = 1
    MOVE = 2
    GUIDING = 3
    REFLEX = 4
    USER_STOPPED = 5
    RECOVERY = 6


class Controller(enum.IntEnum):
    """Control law that moves the arm, as the request ``move`` selects it. A state without a motion has OTHER."""

    JOINT_IMPEDANCE = 0
    CARTESIAN_IMPEDANCE = 1
    EXTERNAL = 2
    OTHER = 3


class Generator(enum.IntEnum):
    """Motion generator, with the numbers that a state reports. In the request ``move`` each number is lower by
    one."""

    IDLE = 0
    JOINT_POSITION = 1
    JOINT_VELOCITY = 2
    CARTESIAN_POSITION = 3
    CARTESIAN_VELOCITY = 4
    NONE = 5


ERRORS = (
    "joint_position_limits_violation",
    "cartesian_position_limits_violation",
    "self_collision_avoidance_violation",
    "joint_velocity_violation",
    "cartesian_velocity_violation",
    "force_control_safety_violation",
    "joint_reflex",
    "cartesian_reflex",
    "max_goal_pose_deviation_violation",
    "max_path_pose_deviation_violation",
    "cartesian_velocity_profile_safety_violation",
    "joint_position_motion_generator_start_pose_invalid",
    "joint_motion_generator_position_limits_violation",
    "joint_motion_generator_velocity_limits_violation",
    "joint_motion_generator_velocity_discontinuity",
    "joint_motion_generator_acceleration_discontinuity",
    "cartesian_position_motion_generator_start_pose_invalid",
    "cartesian_motion_generator_elbow_limit_violation",
    "cartesian_motion_generator_velocity_limits_violation",
    "cartesian_motion_generator_velocity_discontinuity",
    "cartesian_motion_generator_acceleration_discontinuity",
    "cartesian_motion_generator_elbow_sign_inconsistent",
    "cartesian_motion_generator_start_elbow_invalid",
    "force_controller_desired_force_tolerance_violation",
    "start_elbow_sign_inconsistent",
    "communication_constraints_violation",
    "power_limit_violation",
    "cartesian_motion_generator_joint_position_limits_violation",
    "cartesian_motion_generator_joint_velocity_limits_violation",
    "cartesian_motion_generator_joint_velocity_discontinuity",
    "cartesian_motion_generator_joint_acceleration_discontinuity",
    "cartesian_position_motion_generator_invalid_frame",
    "controller_torque_discontinuity",
    "joint_p2p_insufficient_torque_for_planning",
    "tau_j_range_violation",
    "instability_detected",
    "joint_move_in_wrong_direction",
    "cartesian_spline_motion_generator_violation",
    "joint_via_motion_generator_planning_joint_limit_violation",
    "base_acceleration_initialization_timeout",
    "base_acceleration_invalid_reading",
)
"""Names of the controller's errors, in the order of the flags ``errors`` and ``reflex_reason`` of a state."""

_STATE_5 = (
    "message_id:Q O_T_EE:16 O_T_EE_d:16 F_T_EE:16 EE_T_K:16 F_T_NE:16 NE_T_EE:16 m_ee:1 I_ee:9 F_x_Cee:3 m_load:1 "
    "I_load:9 F_x_Cload:3 elbow:2 elbow_d:2 tau_J:7 tau_J_d:7 dtau_J:7 q:7 q_d:7 dq:7 dq_d:7 ddq_d:7 "
    "joint_contact:7 cartesian_contact:6 joint_collision:7 cartesian_collision:6 tau_ext_hat_filtered:7 "
    "O_F_ext_hat_K:6 K_F_ext_hat_K:6 O_dP_EE_d:6 O_ddP_O:3 elbow_c:2 delbow_c:2 ddelbow_c:2 O_T_EE_c:16 "
    "O_dP_EE_c:6 O_ddP_EE_c:6 theta:7 dtheta:7 generator:B controller:B errors:41? reflex_reason:41? robot_mode:B "
    "success_rate:1"
)
_STATE_10 = _STATE_5.replace("generator:B", "accelerometer_top:18 accelerometer_bottom:18 generator:B")

_COMMON = ("connect", "move", "stop")
_SETTERS = ("collision", "joint_impedance", "cartesian_impedance", "guiding", "ee_to_k", "ne_to_ee", "load")

_MOVE_5 = (
    "success",
    "motion_started",
    "preempted",
    "not_possible",
    "start_at_singular_pose",
    "invalid_argument",
    "reflex_aborted",
    "emergency_aborted",
    "input_error_aborted",
    "aborted",
)
_MOVE_10 = (
    "success",
    "motion_started",
    "preempted",
    "preempted_by_safety_functions",
    "rejected_by_safety_functions",
    "not_possible",
    "start_at_singular_pose",
    "invalid_argument",
    "reflex_aborted",
    "emergency_aborted",
    "input_error_aborted",
    "aborted",
)

_Field = tuple[int, struct.Struct]


class State(msgspec.Struct, frozen=True):
    """A state of the controller: the fields that this driver uses, in the vendor's names and in SI units."""

    message_id: int  # The controller's time in milliseconds.
    q: tuple[float, ...]
    q_d: tuple[float, ...]
    dq: tuple[float, ...]
    tau_J: tuple[float, ...]
    tau_ext: tuple[float, ...]
    O_T_EE: tuple[float, ...]
    generator: int
    controller: int
    reasons: tuple[str, ...]  # Names of the present errors, and of the errors that ended the last motion.
    robot_mode: int
    success_rate: float  # Share of the last 100 commands that arrived in time. It is 0 without a motion.


class Command(NamedTuple):
    """One command of a motion. The controller reads what the request ``move`` has selected."""

    message_id: int
    q: tuple[float, ...]
    dq: tuple[float, ...]
    tau: tuple[float, ...]
    finished: bool
    pose: tuple[float, ...] = ()  # Pose of the end effector, column by column.
    twist: tuple[float, ...] = ()  # Velocity of the end effector (m/s), then its angular velocity (rad/s).
    elbow: tuple[float, ...] = ()  # Position of joint 3 (rad) and sign of joint 4; empty if no elbow is commanded.

    @property
    def numbers(self) -> tuple[float, ...]:
        """All numbers, none of which may be infinite or NaN."""
        return (*self.q, *self.dq, *self.tau, *self.pose, *self.twist, *self.elbow)


_REST = (0.0,) * 24  # The Cartesian fields O_T_EE_c, O_dP_EE_c and elbow_c, which a joint motion does not use.
_ZEROS = (0.0,) * 7


class Dialect:
    """One version of FCI: its commands, and the layout of its states and commands."""

    def __init__(self, version: int) -> None:
        """Select the layouts of an FCI version. Raise ``ValueError`` if the version is not supported."""
        if version not in (5, 10):
            raise ValueError(f"FCI {version} is not supported. Use 5 or 10")
        self.version = version
        self.commands: tuple[str, ...]
        self.move_statuses: tuple[str, ...]
        if version == 5:
            self.commands = (*_COMMON, "cartesian_limit", *_SETTERS, "filters", "recover", "model")
            self.move_statuses, fields, number = _MOVE_5, _STATE_5, "d"
            self._command = struct.Struct("<Q7d7d24d??7d")
        else:
            self.commands = (*_COMMON, *_SETTERS, "recover", "model")
            self.move_statuses, fields, number = _MOVE_10, _STATE_10, "f"
            self._command = struct.Struct("<Q7d7d24d??7d?")
        self.fields, self.state_bytes = _layout(fields, number)
        self.command_bytes = self._command.size
        self.move = struct.Struct("<II6d" if version == 5 else "<II6d?7d")

    # -- requests and replies

    def request(self, name: str, request_id: int, payload: bytes = b"") -> bytes:
        return HEADER.pack(self.commands.index(name), request_id, HEADER.size + len(payload)) + payload

    def connect(self, request_id: int, udp_port: int) -> bytes:
        return self.request("connect", request_id, struct.pack("<HH", self.version, udp_port))

    def start_joint_motion(self, request_id: int) -> bytes:
        """Encode the request for a motion by joint positions under the arm's own joint impedance controller."""
        # Allowed deviations from the path, then from the goal. These are the values that libfranka sends.
        deviations = (10.0, math.tau / 2, math.tau) * 2
        extra = () if self.version == 5 else (False, *_ZEROS)
        payload = self.move.pack(Controller.JOINT_IMPEDANCE, Generator.JOINT_POSITION - 1, *deviations, *extra)
        return self.request("move", request_id, payload)

    def name_of(self, code: int) -> str:
        """Return the name of the command with this number, or ``?`` for an unknown number."""
        return self.commands[code] if code < len(self.commands) else "?"

    def move_status(self, status: int) -> str:
        return self.move_statuses[status] if status < len(self.move_statuses) else f"status {status}"

    # -- states of the controller

    def state(self, data: bytes) -> State:
        """Decode a state. Raise ``MalformedFrame`` if it is invalid."""
        if len(data) != self.state_bytes:
            raise MalformedFrame(f"a state of {len(data)} bytes; FCI {self.version} has {self.state_bytes}")
        if not self.is_plausible(data):
            raise MalformedFrame("a state with modes that there are not")
        errors, reflex = self.get(data, "errors"), self.get(data, "reflex_reason")
        state = State(
            int(self.get(data, "message_id")[0]),
            self.get(data, "q"),
            self.get(data, "q_d"),
            self.get(data, "dq"),
            self.get(data, "tau_J"),
            self.get(data, "tau_ext_hat_filtered"),
            self.get(data, "O_T_EE"),
            int(self.get(data, "generator")[0]),
            int(self.get(data, "controller")[0]),
            tuple(name for name, now, then in zip(ERRORS, errors, reflex, strict=True) if now or then),
            int(self.get(data, "robot_mode")[0]),
            self.get(data, "success_rate")[0],
        )
        if not self.has_plausible_joints(data):
            raise MalformedFrame("a state with a position or a speed that no joint has")
        return state

    def is_plausible(self, data: bytes) -> bool:
        """Return whether ``data`` can be a state, by its size and its smallest fields. It is fast enough to check
        a thousand states per second."""
        if len(data) != self.state_bytes:
            return False
        (generator,), (controller,) = self.get(data, "generator"), self.get(data, "controller")
        (mode,), (rate,) = self.get(data, "robot_mode"), self.get(data, "success_rate")
        return generator <= Generator.NONE and controller <= Controller.OTHER and mode <= 6 and 0.0 <= rate <= 1.001

    def has_plausible_joints(self, data: bytes) -> bool:
        """Return whether all joint positions and speeds in a state are possible. It is fast enough to check a
        thousand states per second."""
        row = (*self.get(data, "q"), *self.get(data, "q_d"), *self.get(data, "dq"))
        # ``min`` and ``max`` may pass over a NaN, but the sum contains it.
        return min(row) >= -LARGEST_NUMBER and max(row) <= LARGEST_NUMBER and not math.isnan(sum(row))

    def get(self, data: bytes | bytearray, name: str) -> tuple[float, ...]:
        offset, field = self.fields[name]
        return field.unpack_from(data, offset)

    def put(self, data: bytearray, name: str, *values: float) -> None:
        offset, field = self.fields[name]
        field.pack_into(data, offset, *values)

    # -- commands of a motion

    def position_command(self, message_id: int, q: Sequence[float], finished: bool) -> bytes:
        end = () if self.version == 5 else (False,)
        return self._command.pack(message_id, *q, *_ZEROS, *_REST, False, finished, *_ZEROS, *end)

    def command(self, data: bytes) -> Command:
        """Decode a command. Raise ``MalformedFrame`` if it is invalid."""
        if len(data) != self.command_bytes:
            raise MalformedFrame(f"a command of {len(data)} bytes; FCI {self.version} has {self.command_bytes}")
        row = self._command.unpack(data)
        finished = bool(row[40]) or (self.version != 5 and bool(row[48]))
        elbow = row[37:39] if row[39] else ()
        return Command(row[0], row[1:8], row[8:15], row[41:48], finished, row[15:31], row[31:37], elbow)


class Message(NamedTuple):
    """A request of a client, or the controller's reply to it. Both have the same ``code`` and ``id``."""

    code: int
    id: int
    payload: bytes

    @property
    def raw(self) -> bytes:
        return HEADER.pack(self.code, self.id, HEADER.size + len(self.payload)) + self.payload


class Decoder:
    """Decode a stream of bytes, in pieces of any size, into requests or replies."""

    def __init__(self, largest: int, header: struct.Struct = HEADER) -> None:
        """Decode messages.

        Args:
            largest: Most bytes of a message.
            header: The layout of command, number and size at the start of each message.
        """
        self._largest = largest
        self._header = header
        self._pending = bytearray()

    def feed(self, data: bytes) -> Iterator[Message]:
        """Yield the complete messages. Raise ``MalformedFrame`` at an impossible size, after which the next message
        cannot be located."""
        self._pending += data
        header = self._header
        while len(self._pending) >= header.size:
            code, request_id, size = header.unpack_from(self._pending)
            if not header.size <= size <= self._largest:
                raise MalformedFrame(f"a message of {size} bytes")
            if len(self._pending) < size:
                return
            payload = bytes(self._pending[header.size : size])
            del self._pending[:size]
            yield Message(code, request_id, payload)


def status_of(message: Message) -> int:
    """Return the status of a reply, its first byte. Raise ``MalformedFrame`` if the reply is empty."""
    if not message.payload:
        raise MalformedFrame("a reply without a status")
    return message.payload[0]


def connect_reply(message: Message) -> tuple[int, int]:
    """Return the status in a reply to ``connect``, and the controller's FCI version.

    Raises:
        MalformedFrame: The reply is invalid.
    """
    if len(message.payload) < 3:
        raise MalformedFrame(f"an answer to connect of {len(message.payload)} bytes")
    status, version = struct.unpack_from("<BH", message.payload)
    return status, version


def connect_request(payload: bytes) -> tuple[int, int]:
    """Return the client's FCI version and its UDP port from a request ``connect``.

    Raises:
        MalformedFrame: The request is invalid.
    """
    if len(payload) != 4:
        raise MalformedFrame(f"a connect of {len(payload)} bytes")
    version, port = struct.unpack("<HH", payload)
    return version, port


def _layout(fields: str, number: str) -> tuple[dict[str, _Field], int]:
    """Return the offset and the format of each field of a state, and the size of the state in bytes."""
    offset, layout = 0, {}
    for text in fields.split():
        name, _, code = text.partition(":")
        field = struct.Struct("<" + (code if code in ("Q", "B") or code.endswith("?") else f"{code}{number}"))
        layout[name] = offset, field
        offset += field.size
    return layout, offset


DIALECTS = {version: Dialect(version) for version in (5, 10)}


def mode_name(mode: int) -> str:
    """Return the name of a robot mode for messages, such as ``reflex``."""
    if mode not in tuple(RobotMode):
        return f"mode {mode}"
    return RobotMode(mode).name.lower()
