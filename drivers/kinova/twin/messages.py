"""Encode and decode the messages of actions, poses and limits. Pure.

The numbers of the fields are those of the vendor's public protobuf definitions (Kortex 2.6). Positions are in
metres, and angles in degrees, as on the wire.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.kinova.protocol import SubError

from .errors import CallFailed
from .functions import ActionKind

Fields = dict[int, list[pb.Value]]
Row = Sequence[float]

READ, DELETE = 1, 4
"""Permissions of a stored entity."""
VELOCITY_LIMITATION = 3
BASE_FRAME, TOOL_FRAME, MIXED_FRAME = 3, 2, 1
"""Frames of a twist. ``MIXED_FRAME``: the translation is in the frame of the base, the rotation in that of the
tool."""


def finite(fields: Fields, number: int) -> float:
    """Return a float. Raise ``CallFailed`` if it is not finite."""
    value = pb.last_float(fields, number)
    if not math.isfinite(value):
        raise CallFailed(SubError.INVALID_PARAM, f"field {number} is {value}")
    return value


def sub_message(fields: Fields, number: int) -> Fields:
    return pb.message(pb.last_bytes(fields, number))


def sub_messages(fields: Fields, number: int) -> list[Fields]:
    values = fields.get(number, ())
    if not all(isinstance(value, bytes) for value in values):
        raise MalformedFrame(f"kortex: field {number} is no message")
    return [pb.message(value) for value in values if isinstance(value, bytes)]


def repeated_floats(fields: Fields, number: int) -> tuple[float, ...]:
    """Return a repeated float, packed or not. Raise ``CallFailed`` if one of them is not finite."""
    values: list[float] = []
    for value in fields.get(number, ()):
        if isinstance(value, int):
            values.append(pb.as_float(value))
        elif len(value) % 4:
            raise MalformedFrame(f"kortex: {len(value)} bytes of packed floats in field {number}")
        else:
            values.extend(struct.unpack(f"<{len(value) // 4}f", value))
    if not all(map(math.isfinite, values)):
        raise CallFailed(SubError.INVALID_PARAM, f"field {number} has {values}")
    return tuple(values)


def text(fields: Fields, number: int) -> str:
    try:
        return pb.last_bytes(fields, number).decode()
    except UnicodeDecodeError:
        raise MalformedFrame(f"kortex: field {number} is no UTF-8") from None


def floats(values: Iterable[float], first: int = 1) -> bytes:
    """Encode floats with consecutive field numbers."""
    return b"".join(pb.float_field(number, value) for number, value in enumerate(values, first))


def encode_angles(degrees: Iterable[float]) -> bytes:
    """Encode ``JointAngles``."""
    angles = (pb.varint_field(1, joint) + pb.float_field(2, value) for joint, value in enumerate(degrees))
    return b"".join(pb.bytes_field(1, angle) for angle in angles)


def decode_angles(fields: Fields) -> tuple[float, ...]:
    """Return the angles of ``JointAngles`` in their order.

    The vendor's examples give no identifiers in some places, so the order counts.
    """
    return tuple(finite(angle, 2) for angle in sub_messages(fields, 1))


def decode_pose(fields: Fields) -> tuple[float, ...]:
    """Return x, y, z in metres and the three angles in degrees."""
    return tuple(finite(fields, number) for number in range(1, 7))


def encode_joint_limits(degrees_s: Iterable[float]) -> bytes:
    limits = (
        pb.varint_field(1, joint) + pb.varint_field(2, VELOCITY_LIMITATION) + pb.float_field(3, value)
        for joint, value in enumerate(degrees_s)
    )
    return b"".join(pb.bytes_field(1, limit) for limit in limits)


class Handle(NamedTuple):
    """The reference to a stored entity."""

    identifier: int
    permission: int = READ | DELETE

    def encode(self) -> bytes:
        return pb.varint_field(1, self.identifier) + pb.fixed32_field(2, self.permission)


def identifier_of(payload: bytes) -> int:
    """Return the number in a handle."""
    return pb.last_int(pb.message(payload), 1)


# -- actions


PARAMETERS: Mapping[int, ActionKind] = {
    4: ActionKind.SEND_TWIST_COMMAND,
    5: ActionKind.SEND_WRENCH_COMMAND,
    7: ActionKind.SEND_JOINT_SPEEDS,
    9: ActionKind.REACH_POSE,
    10: ActionKind.REACH_JOINT_ANGLES,
    16: ActionKind.TOGGLE_ADMITTANCE_MODE,
    17: ActionKind.SNAPSHOT,
    19: ActionKind.SWITCH_CONTROL_MAPPING,
    20: ActionKind.NAVIGATE_JOINTS,
    21: ActionKind.NAVIGATE_MAPPINGS,
    25: ActionKind.CHANGE_TWIST,
    26: ActionKind.CHANGE_JOINT_SPEEDS,
    28: ActionKind.CHANGE_WRENCH,
    31: ActionKind.APPLY_EMERGENCY_STOP,
    32: ActionKind.CLEAR_FAULTS,
    34: ActionKind.TIME_DELAY,
    35: ActionKind.EXECUTE_ACTION,
    36: ActionKind.SEND_GRIPPER_COMMAND,
    37: ActionKind.SEND_GPIO_COMMAND,
    38: ActionKind.STOP_ACTION,
    39: ActionKind.PLAY_PRE_COMPUTED_TRAJECTORY,
    40: ActionKind.EXECUTE_SEQUENCE,
    41: ActionKind.EXECUTE_WAYPOINT_LIST,
}
"""Field of the parameters of each type of action."""


class Action(NamedTuple):
    kind: int
    parameters: bytes
    name: str = ""
    application_data: str = ""
    identifier: int = 0
    permission: int = 0

    def encode_handle(self) -> bytes:
        return (
            pb.varint_field(1, self.identifier)
            + pb.varint_field(2, self.kind)
            + pb.fixed32_field(3, self.permission)
        )

    def encode(self) -> bytes:
        number = next(field for field, kind in PARAMETERS.items() if kind == self.kind)
        return (
            pb.bytes_field(1, self.encode_handle())
            + pb.bytes_field(2, self.name.encode())
            + pb.bytes_field(3, self.application_data.encode())
            + pb.bytes_field(number, self.parameters)
        )


def decode_action(payload: bytes) -> Action:
    """Decode an action. Its parameters decide about its type, as clients need not write the type.

    Raises:
        CallFailed: It has no parameters.
        MalformedFrame: The message is malformed.
    """
    fields = pb.message(payload)
    number = next((field for field in PARAMETERS if field in fields), None)
    if number is None:
        raise CallFailed(SubError.INVALID_PARAM, "the action has no parameters")
    value = fields[number][-1]
    handle = sub_message(fields, 1)
    return Action(
        PARAMETERS[number],
        value if isinstance(value, bytes) else b"",
        text(fields, 2),
        text(fields, 3),
        pb.last_int(handle, 1),
    )
