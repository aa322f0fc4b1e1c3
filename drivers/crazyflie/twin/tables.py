"""The simulated firmware's tables of log variables and parameters, as a client reads them.

Names, types and defaults are those of the firmware, and stand in ``tables.toml``. A variable that is not simulated
has the value of a drone at rest without further decks.
"""

from __future__ import annotations

import math
import struct
import tomllib
import zlib
from collections.abc import Callable, Iterator, Sequence
from importlib import resources
from typing import NamedTuple

from .body import Target
from .setpoints import HOVER_THRUST
from .trajectories import Vector

LOG_LAYOUTS = {1: "<B", 2: "<H", 3: "<I", 4: "<b", 5: "<h", 6: "<i", 7: "<f", 8: "<e"}
PARAMETER_LAYOUTS = {0: "<b", 1: "<h", 2: "<i", 6: "<f", 8: "<B", 9: "<H", 10: "<I"}
EXTENDED, READ_ONLY = 0x10, 0x40
"""Flags next to the type of a parameter: its value can be stored, it cannot be written."""

_LOG_CODES = {"u8": 1, "u16": 2, "u32": 3, "i8": 4, "i16": 5, "i32": 6, "f": 7}
_PARAMETER_CODES = {"i8": 0, "i16": 1, "i32": 2, "f": 6, "u8": 8, "u16": 9, "u32": 10}


class Reading(NamedTuple):
    """Values that the simulated firmware measures, estimates and commands."""

    xyz_m: Vector
    velocity_m_s: Vector
    rpy_rad: Vector
    turn_rad_s: Vector
    acceleration_g: Vector
    place_variances: Vector
    speed_variances: Vector
    external_m: Vector
    target: Target
    commanded_rad: Vector
    lift: float
    battery_v: float
    battery_state: int
    bits: int
    memory_errors: int

    @property
    def thrust(self) -> float:
        """Return the thrust in the firmware's units, of 65535."""
        return min(65535.0, self.lift * HOVER_THRUST)

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Return the attitude: w, x, y, z."""
        roll, pitch, yaw = (angle / 2 for angle in self.rpy_rad)
        cr, sr, cp, sp, cy, sy = (f(angle) for angle in (roll, pitch, yaw) for f in (math.cos, math.sin))
        return (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )

    @property
    def own_velocity_m_s(self) -> Vector:
        """Return the velocity in the drone's own frame, which is taken as level."""
        cos, sin = math.cos(self.rpy_rad[2]), math.sin(self.rpy_rad[2])
        vx, vy, vz = self.velocity_m_s
        return cos * vx + sin * vy, cos * vy - sin * vx, vz

    @property
    def place_target(self) -> Vector:
        """Return the commanded place; 0 for an axis without one."""
        x, y = self.target.xy_m or (0.0, 0.0)
        return x, y, self.target.z_m or 0.0


class Variable(NamedTuple):
    group: str
    name: str
    type_code: int
    read: Callable[[Reading], float]

    @property
    def full(self) -> str:
        return f"{self.group}.{self.name}"


class Parameter(NamedTuple):
    group: str
    name: str
    type_code: int  # includes the flags
    value: float

    @property
    def full(self) -> str:
        return f"{self.group}.{self.name}"

    @property
    def layout(self) -> str:
        return PARAMETER_LAYOUTS[self.type_code & 0x0F]


Reader = Callable[[Reading], float]


def _rows(
    group: str, names: str, read: Callable[[Reading], Sequence[float]], factor: float = 1.0
) -> dict[str, Reader]:
    """Return readers of the elements of a vector, one for each name."""

    def element(index: int) -> Reader:
        return lambda it: read(it)[index] * factor

    return {f"{group}.{name}": element(index) for index, name in enumerate(names.split())}


def _attitude(group: str, read: Callable[[Reading], Vector]) -> dict[str, Reader]:
    """Return readers of an attitude in degrees. The firmware counts a pitch with the nose up as positive."""
    return {
        f"{group}.roll": lambda it: read(it)[0] * _DEG,
        f"{group}.pitch": lambda it: -read(it)[1] * _DEG,
        f"{group}.yaw": lambda it: read(it)[2] * _DEG,
    }


_DEG = math.degrees(1.0)
_MILLI = 1e3
_EMPTY_V, _FULL_V = 3.0, 4.2
_SEA_LEVEL_HPA, _HPA_PER_M = 1013.25, 0.12
_READERS: dict[str, Reader] = {
    "pm.vbat": lambda it: it.battery_v,
    "pm.vbatMV": lambda it: it.battery_v * _MILLI,
    "pm.state": lambda it: it.battery_state,
    "pm.batteryLevel": lambda it: max(0.0, min(100.0, (it.battery_v - _EMPTY_V) / (_FULL_V - _EMPTY_V) * 100)),
    **{f"motor.m{number}": lambda it: it.thrust for number in range(1, 5)},
    **_attitude("stabilizer", lambda it: it.rpy_rad),
    "stabilizer.thrust": lambda it: it.thrust,
    **_rows("stateEstimate", "x y z", lambda it: it.xyz_m),
    **_rows("stateEstimate", "vx vy vz", lambda it: it.velocity_m_s),
    **_rows("stateEstimate", "ax ay az", lambda it: it.acceleration_g),
    **_attitude("stateEstimate", lambda it: it.rpy_rad),
    **_rows("stateEstimate", "qw qx qy qz", lambda it: it.quaternion),
    **_rows("stateEstimateZ", "x y z", lambda it: it.xyz_m, _MILLI),
    **_rows("stateEstimateZ", "vx vy vz", lambda it: it.velocity_m_s, _MILLI),
    **_rows("stateEstimateZ", "rateRoll _ rateYaw", lambda it: it.turn_rad_s, _MILLI),
    "stateEstimateZ.ratePitch": lambda it: -it.turn_rad_s[1] * _MILLI,
    **_rows("acc", "x y z", lambda it: it.acceleration_g),
    **_rows("gyro", "x y z", lambda it: it.turn_rad_s, _DEG),
    "baro.asl": lambda it: it.xyz_m[2],
    "baro.pressure": lambda it: _SEA_LEVEL_HPA - _HPA_PER_M * it.xyz_m[2],
    **_rows("ctrltarget", "x y z", lambda it: it.place_target),
    **_rows("ctrltarget", "vx vy vz", lambda it: it.target[:3]),
    "ctrltarget.roll": lambda it: it.target.tilt_rad[0] * _DEG,
    "ctrltarget.pitch": lambda it: -it.target.tilt_rad[1] * _DEG,
    "ctrltarget.yaw": lambda it: it.target.wz_rad_s * _DEG,
    **_rows("ctrltargetZ", "x y z", lambda it: it.place_target, _MILLI),
    **_rows("ctrltargetZ", "vx vy vz", lambda it: it.target[:3], _MILLI),
    "controller.cmd_thrust": lambda it: it.thrust,
    **_attitude("controller", lambda it: it.commanded_rad),
    **_rows("kalman", "stateX stateY stateZ", lambda it: it.xyz_m),
    **_rows("kalman", "statePX statePY statePZ", lambda it: it.own_velocity_m_s),
    **_rows("kalman", "varX varY varZ", lambda it: it.place_variances),
    **_rows("kalman", "varPX varPY varPZ", lambda it: it.speed_variances),
    **_rows("kalman", "q0 q1 q2 q3", lambda it: it.quaternion),
    **_rows("ext_pos", "X Y Z", lambda it: it.external_m),
    "range.zrange": lambda it: max(0.0, it.xyz_m[2]) * _MILLI,
    "sys.canfly": lambda it: it.bits >> 3 & 1,
    "sys.isFlying": lambda it: it.bits >> 4 & 1,
    "sys.isTumbled": lambda it: it.bits >> 5 & 1,
    "supervisor.info": lambda it: it.bits,
    "supervisor.accNorm": lambda it: math.hypot(*it.acceleration_g),
    "memTst.errCntW": lambda it: it.memory_errors,
}


def _items(table: dict[str, str]) -> Iterator[tuple[str, str, str, float]]:
    """Yield group, name, type and value of each entry, for example ``xKp:f=2``."""
    for group, entries in table.items():
        for entry in entries.split():
            named, _, value = entry.partition("=")
            name, _, kind = named.partition(":")
            yield group, name, kind, float(value or 0.0)


def _variable(group: str, name: str, kind: str, value: float) -> Variable:
    read = _READERS.get(f"{group}.{name}", lambda it: value)
    return Variable(group, name, _LOG_CODES[kind], read)


def _parameter(group: str, name: str, kind: str, value: float) -> Parameter:
    """Return a parameter. Its type may end with ``r`` (read-only) or ``p`` (its value can be stored)."""
    flags = READ_ONLY if kind.endswith("r") else EXTENDED if kind.endswith("p") else 0
    return Parameter(group, name, _PARAMETER_CODES[kind.rstrip("rp")] | flags, value)


_TABLES = tomllib.loads(resources.files(__package__).joinpath("tables.toml").read_text("utf-8"))
LOG: tuple[Variable, ...] = tuple(_variable(*item) for item in _items(_TABLES["log"]))
PARAMETERS: tuple[Parameter, ...] = tuple(_parameter(*item) for item in _items(_TABLES["parameters"]))


def checksum(rows: object) -> int:
    """Return the checksum of a table. A client that has stored a table with this checksum need not read it
    again."""
    names = ",".join(f"{row[0]}.{row[1]}:{row[2]}" for row in rows)  # type: ignore[attr-defined]
    return zlib.crc32(names.encode())


def packed(layout: str, value: float) -> bytes:
    """Encode a value as its type. A value out of range becomes the nearest limit."""
    if layout[-1] in "fe":
        return struct.pack(layout, value)
    bits = 8 * struct.calcsize(layout)
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if layout[-1].islower() else (0, (1 << bits) - 1)
    return struct.pack(layout, max(low, min(high, int(value))))
