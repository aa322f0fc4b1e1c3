"""Encode and decode Kortex over TCP: frames, and the few messages that a Gen3 arm needs. Pure.

A frame begins with eight fixed bytes (the magic) and a big-endian length. A protobuf ``Frame`` with a header and a
payload follows. The layout is from the vendor's public protobuf definitions and API reference (Kortex 2.6). The
byte order of the length and the place of the session id were observed with the vendor's Python client 2.6.0.
Facts from neither source are marked [assumed].

Function ids, error codes and states have the vendor's names.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator, Sequence

import msgspec

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

TCP_PORT = 10000
MAGIC = b"\x07xEtRoK\x07"
JOINTS = 7

MAX_FRAME = 8192
"""Most bytes of one protobuf ``Frame``. The longest one in use, the feedback, has fewer than 1000."""

_HEAD = len(MAGIC) + 4
_VERSION = 1


class Kind(enum.IntEnum):
    """Type of a frame, in its header."""

    REQUEST = 1
    RESPONSE = 3
    NOTIFICATION = 5


class Call(enum.IntEnum):
    """Functions of the base. A value is the service number (high 16 bits) with the function number (low 16
    bits)."""

    CREATE_SESSION = 0x10001
    CLOSE_SESSION = 0x10002
    KEEP_ALIVE = 0x10003
    STOP = 0x20070  # The arm decelerates and holds its position.
    SEND_GRIPPER_COMMAND = 0x20088
    SEND_JOINT_SPEEDS = 0x20084  # The speeds stay in force until the next command or stop.
    APPLY_EMERGENCY_STOP = 0x20091
    CLEAR_FAULTS = 0x20092
    SET_SERVOING_MODE = 0x20098
    GET_SERVOING_MODE = 0x20099
    GET_ACTUATOR_COUNT = 0x200AB
    GET_ARM_STATE = 0x200AF
    REFRESH_FEEDBACK = 0x30003


class ArmState(enum.IntEnum):
    BASE_INITIALIZATION = 1
    IDLE = 2
    INITIALIZATION = 3
    IN_FAULT = 4
    MAINTENANCE = 5
    LOW_LEVEL_SERVOING = 6
    SERVOING_READY = 7
    PLAYING_SEQUENCE = 8
    MANUALLY_CONTROLLED = 9
    BRAKE_RELEASE = 10


class ServoingMode(enum.IntEnum):
    SINGLE_LEVEL = 2
    LOW_LEVEL = 3


class SubError(enum.IntEnum):
    """Reason why a call or an action failed."""

    NONE = 0
    METHOD_FAILED = 1
    INVALID_PARAM = 3
    UNSUPPORTED_SERVICE = 4
    UNSUPPORTED_METHOD = 5
    INVALID_SESSION = 12
    PAYLOAD_DECODING_ERR = 13
    INVALID_PASSWORD = 15
    USER_NOT_FOUND = 16
    ENTITY_NOT_FOUND = 17
    ROBOT_MOVEMENT_IN_PROGRESS = 18
    ROBOT_NOT_READY = 21
    ROBOT_IN_FAULT = 22
    ROBOT_IN_MAINTENANCE = 23
    EMERGENCY_STOPPED = 25
    DELETE_PERMISSION_DENIED = 40
    UNSUPPORTED_ACTION = 46
    VALUE_IS_ABOVE_MAXIMUM = 48
    VALUE_IS_BELOW_MINIMUM = 49
    DEVICE_DISCONNECTED = 50
    INVALID_DEVICE = 52
    SAFETY_THRESHOLD_REACHED = 53
    MANUAL_STOP = 55  # A client has stopped an action or a sequence.
    OUTSIDE_WORKSPACE = 56
    ACTUATOR_COUNT_MISMATCH = 57
    INVALID_DURATION = 58
    INVALID_SPEED = 59
    LARGE_SPEED = 60
    JOINT_POSITION_LIMIT = 65
    NO_ACTION = 73
    WRONG_MODE = 75
    USERNAME_ALREADY_EXISTS = 104
    USERNAME_EMPTY = 105
    SESSION_NOT_IN_CONTROL = 130


ERROR_OF_SERVER, ERROR_OF_DEVICE = 1, 3
"""Error codes: an error of the protocol (an unknown function, session or user), and an error of the arm."""


def arm_state_name(state: int) -> str:
    """Return the name and the number of an arm state, such as ``SERVOING_READY (7)``."""
    return _named(ArmState, state)


def sub_error_name(number: int) -> str:
    """Return the name and the number of a sub-error, such as ``ROBOT_IN_FAULT (22)``."""
    return _named(SubError, number)


def _named(enum_type: type[enum.IntEnum], number: int) -> str:
    try:
        return f"{enum_type(number).name} ({number})"
    except ValueError:
        return f"unknown ({number})"


# -- frames


class Frame(msgspec.Struct, frozen=True):
    """One request, response or notification. A response repeats the number of its request in ``message``."""

    kind: int
    call: int
    message: int
    session: int
    payload: bytes = b""
    error: int = 0  # 0 for success, else the part that failed, such as ``ERROR_OF_SERVER``.
    sub_error: int = 0
    device: int = 0  # 0 for the base. The actuators and the interface have their own numbers.

    def encode(self) -> bytes:
        """Return the frame as bytes, with magic and length, as on TCP."""
        body = self.encode_body()
        return MAGIC + len(body).to_bytes(4, "big") + body

    def encode_body(self) -> bytes:
        """Return the protobuf ``Frame`` alone, as in a datagram of UDP."""
        words = (
            _VERSION << 28 | self.kind << 24 | self.device << 16 | self.error << 12 | self.sub_error,
            self.session << 16 | self.message,
            _VERSION << 28 | self.call,
            len(self.payload),
        )
        header = b"".join(pb.fixed32_field(number, word) for number, word in enumerate(words, 1))
        return pb.bytes_field(1, header) + pb.bytes_field(2, self.payload)


def decode(body: bytes) -> Frame:
    """Decode a protobuf ``Frame``, from which magic and length were removed. Raise ``MalformedFrame``."""
    fields = pb.message(body)
    header = pb.message(pb.last_bytes(fields, 1))
    info, message, service, size = (pb.last_int(header, number) & 0xFFFF_FFFF for number in (1, 2, 3, 4))
    payload = pb.last_bytes(fields, 2)
    if size & 0xFF_FFFF != len(payload):
        raise MalformedFrame(f"kortex: {size & 0xFF_FFFF} bytes of payload announced, {len(payload)} there")
    return Frame(
        info >> 24 & 0xF,
        service & 0xFFF_FFFF,
        message & 0xFFFF,
        message >> 16,
        payload,
        info >> 12 & 0xF,
        info & 0xFFF,
        info >> 16 & 0xFF,
    )


class Decoder:
    """Decode a stream of bytes into frames.

    Bytes that form no frame are skipped up to the next magic. They raise no error for two reasons. The driver must
    be able to stop a base even if its responses cannot be decoded. Another process may already have read the
    first part of a frame from this connection.
    """

    def __init__(self) -> None:
        self.skipped = 0  # How often bytes were skipped.
        self._pending = b""

    def feed(self, data: bytes) -> Iterator[Frame]:
        """Yield each complete frame."""
        self._pending += data
        while self._align() and len(self._pending) >= _HEAD:
            size = int.from_bytes(self._pending[len(MAGIC) : _HEAD], "big")
            if size > MAX_FRAME:
                self._skip(len(MAGIC))
                continue
            if len(self._pending) < _HEAD + size:
                return
            body = self._pending[_HEAD : _HEAD + size]
            try:
                frame = decode(body)
            except MalformedFrame:
                # The length of the malformed frame may be wrong. So look for the next magic right after this magic.
                self._skip(len(MAGIC))
                continue
            self._pending = self._pending[_HEAD + size :]
            yield frame

    def _align(self) -> bool:
        """Drop the bytes before the next magic. A partial magic at the end is kept, because its rest may follow.

        Return True if any bytes are left.
        """
        start = self._pending.find(MAGIC)
        if start < 0:
            begins = (size for size in range(len(MAGIC) - 1, 0, -1) if self._pending.endswith(MAGIC[:size]))
            start = len(self._pending) - next(begins, 0)
        if start:
            self._skip(start)
        return bool(self._pending)

    def _skip(self, count: int) -> None:
        self.skipped += 1
        self._pending = self._pending[count:]


# -- messages


class Login(msgspec.Struct, frozen=True):
    """``CreateSessionInfo``."""

    username: str
    password: str
    # Timeouts without a request, after which the base ends the session. The values are from the vendor's examples.
    session_ms: int = 60_000
    connection_ms: int = 2_000

    def encode(self) -> bytes:
        return (
            pb.bytes_field(1, self.username.encode())
            + pb.varint_field(2, self.session_ms)
            + pb.bytes_field(3, self.password.encode())
            + pb.varint_field(4, self.connection_ms)
        )

    @classmethod
    def decode(cls, data: bytes) -> Login:
        """Raise ``MalformedFrame``."""
        fields = pb.message(data)
        try:
            username, password = (pb.last_bytes(fields, number).decode() for number in (1, 3))
        except UnicodeDecodeError:
            raise MalformedFrame("kortex: a name that is no UTF-8") from None
        return cls(username, password, pb.last_int(fields, 2), pb.last_int(fields, 4))


def encode_number(value: int) -> bytes:
    """Encode ``ArmStateInformation``, ``ServoingModeInformation`` or ``ActuatorCount``."""
    return pb.varint_field(1, value)


def decode_number(data: bytes) -> int:
    """Decode the number in one of the messages of ``encode_number``. Raise ``MalformedFrame``."""
    return pb.last_int(pb.message(data), 1)


def encode_speeds(deg_s: Sequence[float]) -> bytes:
    """Encode ``JointSpeeds`` of all joints. Durations are left out: the vendor has not implemented them."""
    return b"".join(
        pb.bytes_field(1, pb.varint_field(1, joint) + pb.float_field(2, value)) for joint, value in enumerate(deg_s)
    )


def decode_speeds(data: bytes) -> dict[int, float]:
    """Decode ``JointSpeeds``: return the speed in deg/s of each joint number. Raise ``MalformedFrame``."""
    speeds: dict[int, float] = {}
    for joint in _messages(pb.message(data), 1):
        speeds[pb.last_int(joint, 1)] = pb.last_float(joint, 2)
    return speeds


class Actuator(msgspec.Struct, frozen=True):
    """Measurements of one joint."""

    position_deg: float = 0.0  # Angle in degrees, 0 to 360.
    velocity_deg_s: float = 0.0
    torque_nm: float = 0.0
    current_a: float = 0.0
    motor_c: float = 0.0
    core_c: float = 0.0
    faults: tuple[int, int] = (0, 0)  # The vendor's fault bits: bank A and bank B.


class Fingers(msgspec.Struct, frozen=True):
    """Measurements of the gripper on the interface, of its one motor."""

    closed: float  # In percent.
    speed: float  # In percent of the full speed.
    current_ma: float


class Feedback(msgspec.Struct, frozen=True):
    """Measurements of the arm: the fields of ``BaseCyclic.Feedback`` that this driver uses.

    ``frame`` is the number of the base's cycle in which it measured. A feedback with the same number as the last
    one contains no new measurement.
    """

    arm_state: int
    actuators: tuple[Actuator, ...]
    arm_v: float = 0.0
    tool_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    faults: tuple[int, int] = (0, 0)
    frame: int = 0
    fingers: Fingers | None = None  # None without a gripper.

    def unwrapped(self, last_positions: Sequence[float]) -> tuple[float, ...]:
        """Return the joint positions in rad, without jumps at 360 degrees from ``last_positions``."""
        return unwrap([math.radians(actuator.position_deg) for actuator in self.actuators], last_positions)

    def encode(self, more_of_base: bytes = b"", more: bytes = b"") -> bytes:
        """Encode the feedback.

        Args:
            more_of_base: Further fields of the base, encoded.
            more: Further fields of the feedback, encoded.
        """
        base = (
            pb.varint_field(2, self.arm_state)
            + pb.float_field(3, self.arm_v)
            + b"".join(pb.float_field(13 + index, value) for index, value in enumerate(self.tool_m))
            + b"".join(pb.fixed32_field(31 + index, bank) for index, bank in enumerate(self.faults))
            + more_of_base
        )
        actuators = b"".join(pb.bytes_field(3, _encode(actuator)) for actuator in self.actuators)
        return pb.fixed32_field(1, self.frame) + pb.bytes_field(2, base) + actuators + more

    @classmethod
    def decode(cls, data: bytes) -> Feedback:
        """Decode a feedback. Raise ``MalformedFrame``, also for numbers that are not finite."""
        fields = pb.message(data)
        base = pb.message(pb.last_bytes(fields, 2))
        return cls(
            pb.last_int(base, 2),
            tuple(_actuator(actuator) for actuator in _messages(fields, 3)),
            _finite(base, 3),
            (_finite(base, 13), _finite(base, 14), _finite(base, 15)),
            (pb.last_int(base, 31), pb.last_int(base, 32)),
            pb.last_int(fields, 1),
            _fingers(pb.message(pb.last_bytes(fields, 4))),
        )


def unwrap(angles: Sequence[float], last_positions: Sequence[float]) -> tuple[float, ...]:
    """Return joint positions without jumps, from angles that were measured only within one turn.

    Each result is the measured angle plus the whole turns that bring it nearest to the last position. No joint
    makes half a turn between two readings.

    Args:
        angles: Measured angles in rad, each within one turn.
        last_positions: Last positions in rad.
    """
    return tuple(
        before + (angle - before + math.pi) % math.tau - math.pi
        for angle, before in zip(angles, last_positions, strict=True)
    )


_ACTUATOR_FLOATS = (4, 5, 6, 7, 9, 10)
"""Field numbers of an actuator's feedback, in the order of ``Actuator``."""


def _encode(actuator: Actuator) -> bytes:
    *values, faults = msgspec.structs.astuple(actuator)
    return b"".join(
        pb.float_field(number, value) for number, value in zip(_ACTUATOR_FLOATS, values, strict=True)
    ) + b"".join(pb.fixed32_field(11 + index, bank) for index, bank in enumerate(faults))


def _actuator(fields: dict[int, list[pb.Value]]) -> Actuator:
    position, velocity, torque, current, motor, core = (_finite(fields, number) for number in _ACTUATOR_FLOATS)
    faults = pb.last_int(fields, 11), pb.last_int(fields, 12)
    return Actuator(position, velocity, torque, current, motor, core, faults)


def _messages(fields: dict[int, list[pb.Value]], number: int) -> Iterator[dict[int, list[pb.Value]]]:
    for value in fields.get(number, ()):
        if not isinstance(value, bytes):
            raise MalformedFrame(f"kortex: field {number} is no message")
        yield pb.message(value)


def _fingers(interface: dict[int, list[pb.Value]]) -> Fingers | None:
    """Decode the gripper in the feedback of the interface."""
    for gripper in _messages(interface, 18):
        for motor in _messages(gripper, 7):
            return Fingers(_finite(motor, 4), _finite(motor, 5), _finite(motor, 7))
    return None


def encode_gripper(closed: float) -> bytes:
    """Encode a ``GripperCommand`` that moves the fingers to a position: 0 is open and 1 closed."""
    finger = pb.varint_field(1, 1) + pb.float_field(2, closed)
    return pb.varint_field(1, GRIPPER_POSITION) + pb.bytes_field(2, pb.bytes_field(1, finger))


GRIPPER_POSITION = 3
"""Mode of a ``GripperCommand``: go to a position."""


def _finite(fields: dict[int, list[pb.Value]], number: int) -> float:
    value = pb.last_float(fields, number)
    if not math.isfinite(value):
        raise MalformedFrame(f"kortex: field {number} is {value}")
    return value
