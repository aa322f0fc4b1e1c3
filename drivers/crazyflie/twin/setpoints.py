"""Decode setpoints: the packets of the commander's two ports. Pure.

The yaw rates of the old port and of the old kinds have the opposite sign. A packet of another length, or
with a number that is not finite, is no setpoint.

Source: the firmware's page ``crtp_generic_setpoint``, and the protocol numbers of cflib.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.crazyflie.protocol import Setpoint

from .body import Target

LEAST_THRUST, MOST_THRUST = 1000, 60000
"""A smaller thrust of the old port counts as zero, and a larger one as the largest."""
HOVER_THRUST = 36000.0
"""Thrust that carries the drone, of 65535 [assumed]."""
_FULL, _HALF, _PER_M_S = 65535.0, 32767.0, 30.0
_QUATERNION_BITS = 9


def parse_setpoint(kind: int, data: bytes) -> Target:
    """Decode a setpoint of the port for all kinds, not ``STOP``. Raise ``MalformedFrame`` and ``struct.error``."""
    match kind:
        case Setpoint.VELOCITY_WORLD | Setpoint.OLD_VELOCITY_WORLD:
            vx, vy, vz, turn = _floats("<ffff", data)
            return Target(vx, vy, vz, _turn(turn, kind))
        case Setpoint.HOVER | Setpoint.OLD_HOVER:
            vx, vy, turn, z = _floats("<ffff", data)
            return Target(vx, vy, 0.0, _turn(turn, kind), max(0.0, z), world=False)
        case Setpoint.Z_DISTANCE | Setpoint.OLD_Z_DISTANCE:
            roll, pitch, turn, z = _floats("<ffff", data)
            return Target(wz_rad_s=_turn(turn, kind), z_m=z, level=True, tilt_rad=_tilt(roll, pitch))
        case Setpoint.ALTITUDE_HOLD:
            roll, pitch, turn, climb = _floats("<ffff", data)
            return Target(vz_m_s=climb, wz_rad_s=math.radians(turn), level=True, tilt_rad=_tilt(roll, pitch))
        case Setpoint.POSITION:
            x, y, z, yaw = _floats("<ffff", data)
            return Target(xy_m=(x, y), z_m=z, yaw_rad=math.radians(yaw))
        case Setpoint.FULL_STATE:
            return _full_state(data)
        case Setpoint.MANUAL:
            roll, pitch, turn, thrust, is_rate = _floats("<fffH?", data)
            if is_rate:
                raise MalformedFrame("a manual setpoint of rates, which are not modelled")
            return _by_thrust(roll, pitch, turn, thrust)
    raise MalformedFrame(f"a setpoint of kind {kind}")


def parse_rpyt(data: bytes, locked: bool, modes: Mapping[str, float]) -> tuple[Target, bool]:
    """Decode a setpoint of the old port for roll, pitch, yaw rate and thrust.

    Args:
        data: The packet's data.
        locked: The thrust is locked: it counts as zero until a setpoint without thrust has come.
        modes: The parameters ``flightmode``, which give other meanings to the numbers.

    Returns:
        The setpoint, and whether the thrust is locked from now on.
    """
    roll, pitch, turn, thrust = _floats("<fffH", data)
    locked = locked and thrust != 0
    if modes["flightmode.posSet"] and thrust:
        return Target(xy_m=(-pitch, roll), z_m=thrust / 1e3, yaw_rad=math.radians(turn)), locked
    target = _by_thrust(roll, pitch, -turn, 0.0 if locked or thrust < LEAST_THRUST else min(thrust, MOST_THRUST))
    if modes["flightmode.althold"]:
        target = target._replace(lift=None, vz_m_s=(thrust - _HALF) / _HALF)
    if modes["flightmode.poshold"]:
        target = target._replace(level=False, world=False, vx_m_s=pitch / _PER_M_S, vy_m_s=roll / _PER_M_S)
    return target, locked


def _by_thrust(roll_deg: float, pitch_deg: float, turn_deg_s: float, thrust: float) -> Target:
    return Target(
        wz_rad_s=math.radians(turn_deg_s),
        level=True,
        tilt_rad=_tilt(roll_deg, pitch_deg),
        lift=min(thrust, _FULL) / HOVER_THRUST,
    )


def _full_state(data: bytes) -> Target:
    values = struct.unpack("<9hI3h", data)
    x, y, z, vx, vy, vz = (value / 1e3 for value in values[:6])
    return Target(vx, vy, vz, values[12] / 1e3, z, xy_m=(x, y), yaw_rad=yaw_of(*unpack_quaternion(values[9])))


def yaw_of(w: float, x: float, y: float, z: float) -> float:
    """Return the yaw of a quaternion, radians."""
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def unpack_quaternion(packed: int) -> tuple[float, float, float, float]:
    """Unpack a unit quaternion: the place of the largest element in two bits, then sign and size of the others.

    Returns:
        w, x, y and z. The packed order is x, y, z, w.
    """
    largest = packed >> 30
    elements = [0.0] * 4
    for place in (3, 2, 1, 0):
        if place != largest:
            size = (packed & (1 << _QUATERNION_BITS) - 1) / ((1 << _QUATERNION_BITS) - 1) * math.sqrt(0.5)
            elements[place] = -size if packed >> _QUATERNION_BITS & 1 else size
            packed >>= _QUATERNION_BITS + 1
    elements[largest] = math.sqrt(max(0.0, 1.0 - sum(element**2 for element in elements)))
    x, y, z, w = elements
    return w, x, y, z


def _tilt(roll_deg: float, pitch_deg: float) -> tuple[float, float]:
    """Return roll and pitch in radians. The firmware counts a pitch with the nose up as positive."""
    return math.radians(roll_deg), math.radians(-pitch_deg)


def _turn(turn_deg_s: float, kind: int) -> float:
    is_old = kind in (Setpoint.OLD_VELOCITY_WORLD, Setpoint.OLD_Z_DISTANCE, Setpoint.OLD_HOVER)
    return math.radians(-turn_deg_s if is_old else turn_deg_s)


def _floats(layout: str, data: bytes) -> tuple[float, ...]:
    values = struct.unpack(layout, data)
    if not all(map(math.isfinite, values)):
        raise MalformedFrame("a setpoint with a number that is not finite")
    return values


__all__ = ["HOVER_THRUST", "parse_rpyt", "parse_setpoint", "unpack_quaternion", "yaw_of"]
