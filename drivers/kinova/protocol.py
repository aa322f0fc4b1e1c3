"""Encode and decode Kortex over TCP: frames, and the few messages that a Gen3 arm needs. Pure.

A frame is eight bytes of magic, a big-endian length, and a protobuf ``Frame`` with a header and a
payload. The layout is from the vendor's public protobuf definitions and API reference (Kortex 2.6). The
byte order of the length and the place of the session id were observed with the vendor's Python client
2.6.0. Facts from neither source are marked [assumed].

Function ids, error codes and states keep the vendor's names, in English.
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
    """Type of a frame."""

    REQUEST = 1
    RESPONSE = 3
    NOTIFICATION = 5


class Call(enum.IntEnum):
    """Functions of the base: service number, then function number."""

    CREATE_SESSION = 0x10001
    CLOSE_SESSION = 0x10002
    KEEP_ALIVE = 0x10003
    STOP = 0x20070  # decelerate and hold
    SEND_JOINT_SPEEDS = 0x20084  # never expires
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
    """Reason why a call failed."""

    METHOD_FAILED = 1
    INVALID_PARAM = 3
    UNSUPPORTED_METHOD = 5
    INVALID_SESSION = 12
    INVALID_PASSWORD = 15
    USER_NOT_FOUND = 16
    ROBOT_NOT_READY = 21
    ROBOT_IN_FAULT = 22
    EMERGENCY_STOPPED = 25
    INVALID_SPEED = 59
    LARGE_SPEED = 60
    WRONG_MODE = 75


ERROR_OF_SERVER = 1
"""Error code for an error of the server. A client's error has 2, a device's 3."""


def arm_state_name(state: int) -> str:
    """Return the name and the number of a state, as ``SERVOING_READY (7)``."""
    return _named(ArmState, state)


def sub_error_name(number: int) -> str:
    """Return the name and the number of a sub-error, as ``ROBOT_IN_FAULT (22)``."""
    return _named(SubError, number)


def _named(kind: type[enum.IntEnum], number: int) -> str:
    try:
        return f"{kind(number).name} ({number})"
    except ValueError:
        return f"unknown ({number})"


# -- frames


class Frame(msgspec.Struct, frozen=True):
    """One request, response or notification. ``message`` is the number of the request. Its response
    repeats it."""

    kind: int
    call: int
    message: int
    session: int
    payload: bytes = b""
    error: int = 0  # the part that failed, as ``ERROR_OF_SERVER``; 0 for success
    sub_error: int = 0

    def encode(self) -> bytes:
        """Return the bytes for the wire."""
        words = (
            _VERSION << 28 | self.kind << 24 | self.error << 12 | self.sub_error,  # device 0: the base
            self.session << 16 | self.message,
            _VERSION << 28 | self.call,
            len(self.payload),
        )
        header = b"".join(pb.fixed32_field(number, word) for number, word in enumerate(words, 1))
        body = pb.bytes_field(1, header) + pb.bytes_field(2, self.payload)
        return MAGIC + len(body).to_bytes(4, "big") + body


def decode(body: bytes) -> Frame:
    """Decode the protobuf ``Frame`` without magic and length. Raise ``MalformedFrame``."""
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
    )


class Decoder:
    """Decode a stream of bytes into frames. Bytes that form no frame are skipped up to the next magic, and
    counted.

    They raise no error, because a stop must also reach a base whose responses cannot be decoded. Another
    process may also have read a part of a frame from this connection before.
    """

    def __init__(self) -> None:
        self.skipped = 0  # number of skipped stretches of bytes
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
                # The length itself may be wrong, so look for the next magic directly after this one.
                self._skip(len(MAGIC))
                continue
            self._pending = self._pending[_HEAD + size :]
            yield frame

    def _align(self) -> bool:
        """Drop the bytes before the next magic, or before a possible beginning of it. Return whether any
        bytes are left."""
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
    # The session ends after this long without a request. Both values are from the vendor's examples.
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
    """Return what ``encode_number`` encoded. Raise ``MalformedFrame``."""
    return pb.last_int(pb.message(data), 1)


def encode_speeds(deg_s: Sequence[float]) -> bytes:
    """Encode ``JointSpeeds`` of all joints, without durations. The API reference calls durations not
    implemented."""
    return b"".join(
        pb.bytes_field(1, pb.varint_field(1, joint) + pb.float_field(2, value)) for joint, value in enumerate(deg_s)
    )


def decode_speeds(data: bytes) -> dict[int, float]:
    """Return degrees per second by joint number. Raise ``MalformedFrame``."""
    speeds: dict[int, float] = {}
    for joint in _messages(pb.message(data), 1):
        speeds[pb.last_int(joint, 1)] = pb.last_float(joint, 2)
    return speeds


class Actuator(msgspec.Struct, frozen=True):
    """Feedback of one joint."""

    position_deg: float = 0.0  # 0 to 360
    velocity_deg_s: float = 0.0
    torque_nm: float = 0.0
    current_a: float = 0.0
    motor_c: float = 0.0
    core_c: float = 0.0
    faults: tuple[int, int] = (0, 0)  # banks A and B


class Feedback(msgspec.Struct, frozen=True):
    """The fields of ``BaseCyclic.Feedback`` that are used.

    ``frame`` is the number of the cycle of the measurement. A feedback that repeats it has no new
    measurement.
    """

    arm_state: int
    actuators: tuple[Actuator, ...]
    arm_v: float = 0.0
    tool_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    faults: tuple[int, int] = (0, 0)
    frame: int = 0

    def unwrapped(self, known: Sequence[float]) -> tuple[float, ...]:
        """Return the joint positions in radians, as ``unwrap`` with the last positions in ``known``."""
        return unwrap([math.radians(one.position_deg) for one in self.actuators], known)

    def encode(self) -> bytes:
        base = (
            pb.varint_field(2, self.arm_state)
            + pb.float_field(3, self.arm_v)
            + b"".join(pb.float_field(13 + at, value) for at, value in enumerate(self.tool_m))
            + b"".join(pb.fixed32_field(31 + at, bank) for at, bank in enumerate(self.faults))
        )
        actuators = b"".join(pb.bytes_field(3, _encode(one)) for one in self.actuators)
        return pb.fixed32_field(1, self.frame) + pb.bytes_field(2, base) + actuators

    @classmethod
    def decode(cls, data: bytes) -> Feedback:
        """Decode a feedback. Raise ``MalformedFrame``, also for numbers that are not finite."""
        fields = pb.message(data)
        base = pb.message(pb.last_bytes(fields, 2))
        return cls(
            pb.last_int(base, 2),
            tuple(_actuator(one) for one in _messages(fields, 3)),
            _finite(base, 3),
            (_finite(base, 13), _finite(base, 14), _finite(base, 15)),
            (pb.last_int(base, 31), pb.last_int(base, 32)),
            pb.last_int(fields, 1),
        )


def unwrap(seen: Sequence[float], known: Sequence[float]) -> tuple[float, ...]:
    """Return angles without the ambiguity of whole turns.

    Each result is the one nearest to the last position, because no joint makes half a turn between two
    readings.

    Args:
        seen: Measured angles in radians, known up to whole turns.
        known: Last positions in radians.
    """
    return tuple(
        before + (angle - before + math.pi) % math.tau - math.pi for angle, before in zip(seen, known, strict=True)
    )


_ACTUATOR_FLOATS = (4, 5, 6, 7, 9, 10)
"""Field numbers of an actuator's feedback, in the order of ``Actuator``."""


def _encode(actuator: Actuator) -> bytes:
    *values, faults = msgspec.structs.astuple(actuator)
    return b"".join(
        pb.float_field(number, value) for number, value in zip(_ACTUATOR_FLOATS, values, strict=True)
    ) + b"".join(pb.fixed32_field(11 + at, bank) for at, bank in enumerate(faults))


def _actuator(found: dict[int, list[pb.Value]]) -> Actuator:
    position, velocity, torque, current, motor, core = (_finite(found, number) for number in _ACTUATOR_FLOATS)
    faults = pb.last_int(found, 11), pb.last_int(found, 12)
    return Actuator(position, velocity, torque, current, motor, core, faults)


def _messages(found: dict[int, list[pb.Value]], number: int) -> Iterator[dict[int, list[pb.Value]]]:
    for value in found.get(number, ()):
        if not isinstance(value, bytes):
            raise MalformedFrame(f"kortex: field {number} is no message")
        yield pb.message(value)


def _finite(found: dict[int, list[pb.Value]], number: int) -> float:
    value = pb.last_float(found, number)
    if not math.isfinite(value):
        raise MalformedFrame(f"kortex: field {number} is {value}")
    return value
