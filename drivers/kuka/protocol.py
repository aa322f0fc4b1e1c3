"""Encode and decode KUKA's Fast Robot Interface (FRI): one protobuf message per datagram, without a length
in front.

The controller sends a *monitoring message* in every cycle. The client answers with a *command message* that
contains its number. Field numbers are from public descriptions of FRI 1.x. Protobuf can encode repeated doubles
packed or unpacked: this module reads both, and writes unpacked ones [assumed]. Checksums are not checked, because
their polynomial is not published.
"""

from __future__ import annotations

import enum
import math
import zlib
from collections.abc import Sequence
from typing import Final

import msgspec

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from .io import Io, decode_ios, encode_ios

FRI_PORT: Final = 30200
"""UDP port of both ends."""
LARGEST: Final = 1500
"""Most bytes of a datagram: one Ethernet frame."""
MONITORING_ID: Final = 0x245142
COMMAND_ID: Final = 0x34001
JOINTS: Final = 7
NO_JOINTS: Final = (0.0,) * JOINTS
COUNTER: Final = 0xFFFFFFFF
"""Sequence numbers are 32 bits wide."""


class State(enum.IntEnum):
    """State of the FRI session."""

    IDLE = 0
    MONITORING_WAIT = 1
    MONITORING_READY = 2
    COMMANDING_WAIT = 3
    COMMANDING_ACTIVE = 4


class Quality(enum.IntEnum):
    """Quality of the connection. The controller derives it from our answers."""

    POOR = 0
    FAIR = 1
    GOOD = 2
    EXCELLENT = 3


class Drive(enum.IntEnum):
    """State of one joint's drive [assumed]."""

    OFF = 0
    TRANSITIONING = 1
    ACTIVE = 2


class ClientMode(enum.IntEnum):
    """Quantity that the robot program lets the client command."""

    NO_COMMAND_MODE = 0
    POSITION = 1
    WRENCH = 2
    TORQUE = 3


class ControlMode(enum.IntEnum):
    """Control mode in which the controller moves the joints [assumed]."""

    POSITION = 0
    CARTESIAN_IMPEDANCE = 1
    JOINT_IMPEDANCE = 2


class Overlay(enum.IntEnum):
    """Type of motion on the controller to which the client's commands are added (FRI overlay) [assumed]."""

    NO_OVERLAY = 0
    JOINT = 1
    CARTESIAN = 2


def has_reached(sequence: int, number: int) -> bool:
    """Return True if ``sequence`` is equal to ``number`` or later. Sequence numbers wrap around at 32 bits."""
    return (sequence - number) & COUNTER <= COUNTER // 2


def name_of(enum_type: type[enum.IntEnum], number: int) -> str:
    """Return the name of an enum's number, or the number itself if it has no name."""
    try:
        return enum_type(number).name
    except ValueError:
        return str(number)


class Monitoring(msgspec.Struct, frozen=True, gc=False):
    """A monitoring message: the controller's state in one cycle, in rad, Nm and ms."""

    sequence: int
    reflected: int = 0  # Sequence number of the last command message that the controller accepted.
    safety: int = 0  # 0 for normal operation, else the level of the safety stop.
    drives: tuple[int, ...] = ()
    operation_mode: int = 0  # Operation mode of the robot: 0 for T1, 1 for T2, 2 for automatic [assumed].
    control_mode: int = 0
    position: tuple[float, ...] = NO_JOINTS  # Measured joint positions in rad.
    torque: tuple[float, ...] = NO_JOINTS
    commanded: tuple[float, ...] = NO_JOINTS  # Joint positions that the controller commands, in rad.
    external_torque: tuple[float, ...] = NO_JOINTS
    state: int = 0
    quality: int = 0
    sample_ms: int = 0
    multiplier: int = 1  # Number of cycles after which the client must answer (receive multiplier).
    # Joint positions of the robot program's own motion in rad, without the client's overlay. Empty if not sent.
    interpolated: tuple[float, ...] = ()
    client_mode: int = 0
    overlay: int = 0
    tracking: float = 0.0  # How well the arm follows the client's commands, 0 to 1.
    ios: tuple[Io, ...] = ()  # Inputs and outputs that the robot program has registered. The driver reads none.


class Command(msgspec.Struct, frozen=True, gc=False):
    """A command message: the client's answer to a monitoring message. An empty ``position`` moves nothing."""

    sequence: int
    reflected: int  # Sequence number of the monitoring message that it answers.
    position: tuple[float, ...] = ()
    ios: tuple[Io, ...] = ()  # Outputs to set. The driver sets none.


def decode_monitoring(data: bytes) -> Monitoring:
    """Decode a monitoring message. Raise ``MalformedFrame``."""
    top = _top(data, MONITORING_ID)
    header = pb.message(pb.last_bytes(top, 1))
    robot = pb.last_bytes(top, 2)
    robot_fields = pb.message(robot)
    measured = pb.message(pb.last_bytes(top, 3))
    connection = pb.message(pb.last_bytes(top, 4))
    program = pb.message(pb.last_bytes(top, 5))
    joints = pb.last_int(robot_fields, 1, JOINTS)
    if joints != JOINTS:
        raise MalformedFrame(f"FRI: a robot of {joints} joints, this arm has {JOINTS}")
    return Monitoring(
        sequence=pb.last_int(header, 2) & COUNTER,
        reflected=pb.last_int(header, 3) & COUNTER,
        safety=pb.last_int(robot_fields, 2),
        drives=pb.varints(robot, 5)[: 2 * JOINTS],
        operation_mode=pb.last_int(robot_fields, 6),
        control_mode=pb.last_int(robot_fields, 7),
        position=_joints(measured, 1, "measured positions"),
        torque=_joints(measured, 2, "torques", NO_JOINTS),
        commanded=_joints(measured, 3, "commanded positions"),
        external_torque=_joints(measured, 5, "external torques", NO_JOINTS),
        state=pb.last_int(connection, 1),
        quality=pb.last_int(connection, 2),
        sample_ms=pb.last_int(connection, 3),
        multiplier=pb.last_int(connection, 4, 1),
        interpolated=_joints(program, 1, "interpolated positions", ()),
        client_mode=pb.last_int(program, 10),
        overlay=pb.last_int(program, 11),
        tracking=_tracking(program),
    )


def encode_command(command: Command) -> bytes:
    body = _header(COMMAND_ID, command.sequence, command.reflected)
    content = pb.bytes_field(1, pb.double_fields(1, command.position)) if command.position else b""
    content += encode_ios(5, command.ios)
    if content:
        body += pb.bytes_field(2, content)
    return body + pb.bytes_field(15, pb.varint_field(1, len(body)))


def decode_command(data: bytes) -> Command:
    """Decode a command message. Only the simulated controller needs this. Raise ``MalformedFrame``."""
    top = _top(data, COMMAND_ID)
    header = pb.message(pb.last_bytes(top, 1))
    content = pb.message(pb.last_bytes(top, 2))
    position = _joints(content, 1, "positions", ())
    return Command(
        pb.last_int(header, 2) & COUNTER, pb.last_int(header, 3) & COUNTER, position, decode_ios(content, 5)
    )


def encode_monitoring(message: Monitoring, packed: bool = False, checksum: bool = True) -> bytes:
    """Encode a monitoring message. Only the simulated controller needs this.

    ``packed`` selects how protobuf encodes repeated numbers.
    """
    double, whole = pb.double_field, pb.varint_field

    def joints(number: int, values: Sequence[float]) -> bytes:
        return pb.bytes_field(number, pb.double_fields(1, values, packed))

    if packed:
        drives = pb.bytes_field(5, bytes(message.drives))
    else:
        drives = b"".join(whole(5, drive) for drive in message.drives)
    robot = whole(1, JOINTS) + whole(2, message.safety) + drives
    robot += whole(6, message.operation_mode) + whole(7, message.control_mode)
    measured = joints(1, message.position) + joints(2, message.torque) + joints(3, message.commanded)
    measured += joints(4, message.torque) + joints(5, message.external_torque) + encode_ios(8, message.ios)
    connection = whole(1, message.state) + whole(2, message.quality) + whole(3, message.sample_ms)
    program = b""
    if message.interpolated:
        program = joints(1, message.interpolated) + whole(10, message.client_mode) + whole(11, message.overlay)
        program += double(12, message.tracking)
    body = _header(MONITORING_ID, message.sequence, message.reflected)
    body += pb.bytes_field(2, robot) + pb.bytes_field(3, measured)
    body += pb.bytes_field(4, connection + whole(4, message.multiplier)) + pb.bytes_field(5, program)
    end = whole(1, len(body))
    if checksum:
        end += pb.bytes_field(2, whole(1, zlib.crc32(body)))
    return body + pb.bytes_field(15, end)


_Fields = dict[int, list[pb.Value]]


def _header(number: int, sequence: int, reflected: int) -> bytes:
    fields = pb.varint_field(1, number) + pb.varint_field(2, sequence & COUNTER)
    return pb.bytes_field(1, fields + pb.varint_field(3, reflected & COUNTER))


def _top(data: bytes, number: int) -> _Fields:
    if len(data) > LARGEST:
        raise MalformedFrame(f"FRI: {len(data)} bytes, {LARGEST} at most")
    top = pb.message(data)
    actual = pb.last_int(pb.message(pb.last_bytes(top, 1)), 1)
    if actual != number:
        raise MalformedFrame(f"FRI: message {actual:#x} instead of {number:#x}")
    return top


def _joints(fields: _Fields, number: int, name: str, missing: tuple[float, ...] | None = None) -> tuple[float, ...]:
    """Return the numbers in a field, one per joint. Raise ``MalformedFrame`` if they are not seven finite numbers.

    If the message has no such field, return ``missing``, or raise if ``missing`` is None.
    """
    if missing is not None and number not in fields:
        return missing
    values = pb.doubles(pb.last_bytes(fields, number), 1)
    if len(values) != JOINTS or not all(map(math.isfinite, values)):
        raise MalformedFrame(f"FRI: {len(values)} {name} instead of {JOINTS}, or one that is not finite")
    return values


def _tracking(program: _Fields) -> float:
    value = pb.as_double(pb.last_int(program, 12))
    return value if math.isfinite(value) else 0.0
