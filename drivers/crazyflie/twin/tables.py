"""The simulated firmware's tables of log variables and parameters, as a client reads them: group, name, type,
value.

Names and types are those of the firmware. The real tables are some hundred rows longer.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import NamedTuple

LOG_LAYOUTS = {1: "<B", 2: "<H", 3: "<I", 4: "<b", 5: "<h", 6: "<i", 7: "<f", 8: "<e"}
PARAMETER_LAYOUTS = {0: "<b", 1: "<h", 2: "<i", 6: "<f", 8: "<B", 9: "<H", 10: "<I"}

_U8, _U16, _U32, _FLOAT = 1, 2, 3, 7
_PARAMETER_U8, _PARAMETER_FLOAT = 8, 6
READ_ONLY = 0x40


class Reading(NamedTuple):
    """The simulated estimator's values, in the firmware's units."""

    xyz_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]
    rpy_deg: tuple[float, float, float]
    wz_deg_s: float
    battery_v: float
    battery_state: int
    bits: int
    thrust: float


class Variable(NamedTuple):
    group: str
    name: str
    type_code: int
    read: Callable[[Reading], float]

    @property
    def full(self) -> str:
        return f"{self.group}.{self.name}"


LOG: tuple[Variable, ...] = (
    Variable("pm", "vbat", _FLOAT, lambda it: it.battery_v),
    Variable("pm", "state", _U8, lambda it: it.battery_state),
    Variable("pm", "batteryLevel", _U8, lambda it: 80),
    Variable("stateEstimate", "x", _FLOAT, lambda it: it.xyz_m[0]),
    Variable("stateEstimate", "y", _FLOAT, lambda it: it.xyz_m[1]),
    Variable("stateEstimate", "z", _FLOAT, lambda it: it.xyz_m[2]),
    Variable("stateEstimate", "vx", _FLOAT, lambda it: it.velocity_m_s[0]),
    Variable("stateEstimate", "vy", _FLOAT, lambda it: it.velocity_m_s[1]),
    Variable("stateEstimate", "vz", _FLOAT, lambda it: it.velocity_m_s[2]),
    Variable("stabilizer", "roll", _FLOAT, lambda it: it.rpy_deg[0]),
    Variable("stabilizer", "pitch", _FLOAT, lambda it: -it.rpy_deg[1]),
    Variable("stabilizer", "yaw", _FLOAT, lambda it: it.rpy_deg[2]),
    Variable("stabilizer", "thrust", _FLOAT, lambda it: it.thrust),
    Variable("gyro", "x", _FLOAT, lambda it: 0.0),
    Variable("gyro", "y", _FLOAT, lambda it: 0.0),
    Variable("gyro", "z", _FLOAT, lambda it: it.wz_deg_s),
    Variable("supervisor", "info", _U16, lambda it: it.bits),
    Variable("sys", "canfly", _U8, lambda it: 1),
    Variable("radio", "rssi", _U8, lambda it: 45),
    Variable("crtp", "rxRate", _U16, lambda it: 20),
)


class Parameter(NamedTuple):
    group: str
    name: str
    type_code: int  # includes READ_ONLY for a parameter that cannot be written
    value: float

    @property
    def layout(self) -> str:
        return PARAMETER_LAYOUTS[self.type_code & 0x0F]


PARAMETERS: tuple[Parameter, ...] = (
    Parameter("stabilizer", "estimator", _PARAMETER_U8, 2),
    Parameter("stabilizer", "controller", _PARAMETER_U8, 1),
    Parameter("stabilizer", "stop", _PARAMETER_U8, 0),
    Parameter("commander", "enHighLevel", _PARAMETER_U8, 1),
    Parameter("kalman", "resetEstimation", _PARAMETER_U8, 0),
    Parameter("deck", "bcFlow2", _PARAMETER_U8 | READ_ONLY, 1),
    Parameter("posCtlPid", "xVelMax", _PARAMETER_FLOAT, 1.0),
    Parameter("posCtlPid", "zVelMax", _PARAMETER_FLOAT, 1.0),
    Parameter("imu_sensors", "imuPhi", _PARAMETER_FLOAT, 0.0),
)


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
