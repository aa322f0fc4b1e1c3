"""Encode and decode the reports that an xArm controller sends. Pure: no I/O, no clock.

    u32 size | u8 state | mode << 4 | u16 queue | 7 f32 joints | 6 f32 pose | 7 f32 torques | ...

Size and queue are big-endian, floats little-endian. The source is the vendor's Python SDK 1.18.4.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from .protocol import JOINTS, Version, unpack_floats

NORMAL_PORT, RICH_PORT, REAL_PORT = 30001, 30002, 30003

REAL_SIZE, NORMAL_SIZE, RICH_SIZE = 135, 145, 494
_SMALLEST, _LARGEST = 87, 2048
_SPEED_LIMIT_OFFSET = 217
_CODES_OFFSET = 89

_BASE = struct.Struct("<7f6f7f")
_BASE_OFFSET = 7


class Report(NamedTuple):
    """The fields at the beginning of every report."""

    state: int
    mode: int
    queue: int
    position_rad: tuple[float, ...]
    pose_mm_rad: tuple[float, ...]
    torque_nm: tuple[float, ...]  # torque of each joint; unit N m [assumed]


class ReportDecoder:
    """Decode a stream of bytes, in pieces of any size, into reports. Each report begins with its size."""

    def __init__(self) -> None:
        self._pending = bytearray()

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield the complete reports. Raise ``MalformedFrame`` at an impossible size."""
        self._pending += data
        while len(self._pending) >= 4:
            (size,) = struct.unpack_from(">I", self._pending)
            if not _SMALLEST <= size <= _LARGEST:
                raise MalformedFrame(f"a report of {size} bytes")
            if len(self._pending) < size:
                return
            report = bytes(self._pending[:size])
            del self._pending[:size]
            yield report


def parse_report(data: bytes) -> Report:
    """Decode the fields that every report has. Raise ``MalformedFrame`` if the report is too short, or if a joint
    position is not finite."""
    if len(data) < _SMALLEST:
        raise MalformedFrame(f"a report of {len(data)} bytes")
    state_and_mode, queue = data[4], int.from_bytes(data[5:7], "big")
    numbers = _BASE.unpack_from(data, _BASE_OFFSET)
    position = numbers[:7]
    if not all(math.isfinite(rad) for rad in position):
        raise MalformedFrame(f"joints at {position}")
    return Report(state_and_mode & 0x0F, state_and_mode >> 4, queue, position, numbers[7:13], numbers[13:])


def speed_limit_of(rich: bytes) -> float | None:
    """Return the controller's joint speed limit from a rich report, in rad/s; None if it is missing or
    impossible."""
    if len(rich) < _SPEED_LIMIT_OFFSET + 4:
        return None
    (limit,) = unpack_floats(rich, 1, _SPEED_LIMIT_OFFSET)
    return limit if 0.0 < limit < math.inf else None


def pack_report(size: int, report: Report) -> bytearray:
    """Make a report of ``size`` bytes. Fields outside ``Report`` are zero."""
    data = bytearray(size)
    struct.pack_into(">IBH", data, 0, size, report.state | report.mode << 4, report.queue)
    _BASE.pack_into(data, _BASE_OFFSET, *report.position_rad, *report.pose_mm_rad, *report.torque_nm)
    return data


class Details(NamedTuple):
    """The fields of the normal and the rich report that the shortest report does not have."""

    enabled: int  # enabled motors, one bit per joint
    error: int
    warning: int


def pack_details(data: bytearray, details: Details) -> None:
    """Write the details into a normal or rich report."""
    data[87:89] = details.enabled, details.enabled  # two bytes, one bit per joint: brakes released, motors on
    data[_CODES_OFFSET : _CODES_OFFSET + 2] = details.error, details.warning
    data[131:133] = 3, 3  # collision sensitivity, teaching sensitivity
    struct.pack_into("<f", data, 141, -9.81)


def pack_rich(data: bytearray, version: Version, text: str, speed_limit_rad_s: float, celsius: int) -> None:
    """Write the fields of a rich report. ``text`` is the version text. All limits except ``speed_limit_rad_s`` are
    the defaults of the vendor's SDK."""
    data[145:151] = version.arm_type, version.axes, 1, 1, 0, 0
    data[151:181] = text.encode()[:30].ljust(30, b"\0")
    struct.pack_into("<5f", data, 181, 1000.0, 1.0, 50000.0, 0.1, 1000.0)
    struct.pack_into("<5f", data, 201, 20.0, 0.01, 20.0, 0.0001, speed_limit_rad_s)
    struct.pack_into("<2f", data, 221, 2.3, 4.0)
    data[245 : 245 + JOINTS] = bytes((celsius,)) * JOINTS
