"""The state that an RB-Y1 sends as a stream, many times a second. Pure: no I/O. For the field
numbers see ``protocol``."""

from __future__ import annotations

import enum
import math
import struct
from collections.abc import Sequence

import msgspec

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from .commands import encode_duration
from .protocol import ManagerState, Power, double, messages

NS = 1_000_000_000
MAX_JOINTS = 64


class Fet(enum.IntEnum):
    ON = 1
    OFF = 2


class Run(enum.IntEnum):
    CONTROL_ON = 1
    CONTROL_OFF = 2


class RobotState(msgspec.Struct, frozen=True):
    """A decoded ``GetRobotStateResponse``. Each list has one value per joint of the robot, by joint
    index."""

    position: tuple[float, ...]
    velocity: tuple[float, ...] = ()
    torque: tuple[float, ...] = ()
    target: tuple[float, ...] = ()
    current: tuple[float, ...] = ()
    temperature: tuple[float, ...] = ()
    ready: tuple[bool, ...] = ()
    powers: tuple[int, ...] = ()
    emergency_stops: tuple[int, ...] = ()  # one number for each emergency stop button; 1 if it is pressed
    battery_pct: float = math.nan
    battery_v: float = math.nan
    odometry: tuple[float, float, float] = (0.0, 0.0, 0.0)  # x, y, heading
    center_of_mass: tuple[float, float, float] = (0.0, 0.0, 0.0)
    manager: ManagerState = ManagerState()
    time_ns: int = 0  # time by the robot's clock
    # Encoded, and not decoded: the states of the right and the left tool flange, and the pairs of links that are
    # nearest to each other.
    flanges: tuple[bytes, ...] = ()
    collisions: tuple[bytes, ...] = ()

    @property
    def pressed(self) -> bool:
        """Whether any emergency stop button is pressed."""
        return any(self.emergency_stops)

    @property
    def powered(self) -> bool:
        """Whether every power supply of the robot is on."""
        return bool(self.powers) and all(power == Power.ON for power in self.powers)

    def is_off(self, supply: int | None) -> bool:
        """Return True if the state shows that a power supply is off.

        Args:
            supply: Index of the supply in ``RobotInfo.supplies``; None if the robot did not report it.
        """
        return supply is not None and supply < len(self.powers) and self.powers[supply] == Power.OFF

    @classmethod
    def decode(cls, data: bytes) -> RobotState:
        """Decode a response. Raise ``MalformedFrame``, also for positions or velocities that are not finite."""
        answer = pb.message(data)
        state = pb.last_bytes(answer, 2)
        fields = pb.message(state)
        position, velocity = _row(fields, 31), _row(fields, 32)
        if not all(map(math.isfinite, (*position, *velocity))):
            raise MalformedFrame("rb.api: a position or velocity that is not finite")
        if len(position) > MAX_JOINTS or len(velocity) != len(position):
            raise MalformedFrame(f"rb.api: {len(position)} positions, {len(velocity)} velocities")
        battery = pb.message(pb.last_bytes(fields, 3))
        odometry = pb.message(pb.last_bytes(fields, 45))
        place = pb.message(pb.last_bytes(odometry, 1))
        mass = pb.message(pb.last_bytes(fields, 46))
        time = pb.message(pb.last_bytes(fields, 1))
        return cls(
            position,
            velocity,
            _row(fields, 34),
            _row(fields, 41),
            _row(fields, 33),
            tuple(float(_signed(value)) for value in _numbers(fields, 48)),
            tuple(value != 0.0 for value in _row(fields, 30)),
            tuple(pb.last_int(entry, 1) for entry in messages(fields, 4)),
            tuple(pb.last_int(entry, 1) for entry in messages(fields, 100)),
            double(battery, 3) if battery else math.nan,
            double(battery, 1) if battery else math.nan,
            (double(place, 1), double(place, 2), double(odometry, 2)),
            (double(mass, 1), double(mass, 2), double(mass, 3)),
            ManagerState.decode(pb.last_bytes(answer, 3)),
            pb.last_int(time, 1) * NS + pb.last_int(time, 2),
        )

    def encode(self) -> bytes:
        """Encode the state as the robot's server does."""
        x, y, heading = self.odometry
        battery = pb.double_field(1, self.battery_v) + pb.double_field(3, self.battery_pct)
        place = pb.double_field(1, x) + pb.double_field(2, y)
        seconds, nanos = divmod(self.time_ns, NS)
        count = len(self.position)
        state = (
            pb.bytes_field(1, pb.varint_field(1, seconds) + pb.varint_field(2, nanos))
            + pb.bytes_field(3, battery)
            + b"".join(pb.bytes_field(4, pb.varint_field(1, power) + _volts(power)) for power in self.powers)
            + b"".join(pb.bytes_field(5, self._joint(joint)) for joint in range(count))
            + b"".join(pb.bytes_field(number, flange) for number, flange in enumerate(self.flanges, 6))
            + pb.double_fields(30, [float(ready) for ready in self.ready], packed=True)
            + pb.double_fields(31, self.position, packed=True)
            + pb.double_fields(32, self.velocity, packed=True)
            + pb.double_fields(33, self.current, packed=True)
            + pb.double_fields(34, self.torque, packed=True)
            + pb.double_fields(41, self.target, packed=True)
            + pb.double_fields(42, [0.0] * count, packed=True)
            + b"".join(pb.varint_field(43, 10) for _ in range(count))
            + pb.double_fields(44, [0.0] * count, packed=True)
            + pb.bytes_field(45, pb.bytes_field(1, place) + pb.double_field(2, heading))
            + pb.bytes_field(46, _vector(self.center_of_mass))
            + b"".join(pb.bytes_field(47, pair) for pair in self.collisions)
            + b"".join(pb.varint_field(48, round(celsius)) for celsius in self.temperature)
            + b"".join(pb.bytes_field(100, pb.varint_field(1, pressed)) for pressed in self.emergency_stops)
        )
        return pb.bytes_field(2, state) + pb.bytes_field(3, self.manager.encode())

    def _joint(self, index: int) -> bytes:
        """Encode ``JointState``."""
        ready = bool(self.ready[index])
        return (
            pb.varint_field(1, int(ready))
            + pb.varint_field(2, Fet.ON if ready else Fet.OFF)
            + pb.varint_field(3, Run.CONTROL_ON if ready else Run.CONTROL_OFF)
            + pb.varint_field(4, 1)
            # Without this field the vendor's client assumes that the servo is off.
            + pb.bytes_field(9, encode_duration(0.0))
            + pb.varint_field(10, int(self.powered))
            + pb.double_field(11, self.position[index])
            + pb.double_field(12, self.velocity[index])
            + pb.double_field(14, self.torque[index])
            + pb.double_field(21, self.target[index])
            + pb.varint_field(30, round(self.temperature[index]))
        )


def _row(fields: dict[int, list[pb.Value]], number: int) -> tuple[float, ...]:
    """Decode a repeated ``double`` field of a parsed message. Raise ``MalformedFrame``.

    It works on the parsed fields, so that a message is parsed once: a hundred arrive every second.
    """
    values = fields.get(number, [])
    if len(values) == 1 and isinstance(values[0], bytes) and len(values[0]) % 8 == 0:
        return struct.unpack(f"<{len(values[0]) // 8}d", values[0])
    return pb.doubles(b"".join(_again(number, value) for value in values), number)


def _again(number: int, value: pb.Value) -> bytes:
    return (
        pb.bytes_field(number, value) if isinstance(value, bytes) else pb.double_field(number, pb.as_double(value))
    )


def _numbers(fields: dict[int, list[pb.Value]], number: int) -> list[int]:
    """Decode a repeated varint field, packed or not. Raise ``MalformedFrame``."""
    numbers: list[int] = []
    for value in fields.get(number, ()):
        numbers += [value] if isinstance(value, int) else pb.varints(pb.bytes_field(number, value), number)
    return numbers


def _volts(power: int) -> bytes:
    return pb.double_field(2, 48.0 if power == Power.ON else 0.0)


def _vector(row: Sequence[float]) -> bytes:
    return b"".join(pb.double_field(number, value) for number, value in enumerate(row, 1))


def _signed(value: int) -> int:
    return value - (1 << 64) if value >> 63 else value
