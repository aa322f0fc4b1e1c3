"""Make an observation from a Spot's reading, and judge whether the robot stands still. Pure: no I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping

from strands_actors.contract.wire import Observation

from .gates import BEHAVIOUR
from .protocol import Motors, Reading
from .robots import ARM, BASE, CLAW, LEG_SENSORS, LEGS, wire_name

Targets = tuple[float | None, ...]

STILL = 0.05
"""Speed below which the robot stands still, m/s and rad/s [assumed]."""

_JOINTS = (*ARM, CLAW)
_NOT_THERE = (math.nan, 0.0)


def sensors_of(reading: Reading) -> dict[str, tuple[float, ...]]:
    """Return the values beside the axes, by names that end with the unit."""
    values = {
        "xyz_m": reading.xyz_m,
        "rpy_rad": reading.rpy_rad,
        "quaternion_wxyz": reading.quaternion,
        "linear_m_s": (*reading.twist[:2], 0.0),
        "angular_rad_s": (0.0, 0.0, reading.twist[2]),
        "battery_pct": (reading.battery_pct,),
        "battery_v": (reading.battery_v,),
        "motors": (float(reading.motors),),
        "estopped": (float(len(reading.pressed)),),
    }
    legs = [(key, reading.joints.get(wire_name(key))) for key in LEGS]
    return {**values, **{LEG_SENSORS[key]: (joint[0],) for key, joint in legs if joint is not None}}


def observe(reading: Reading, stamp_ns: int, faults: Mapping[str, str]) -> Observation:
    """Return the observation for a reading. ``stamp_ns`` is the time at which it was new."""
    known = [reading.joints.get(wire_name(key), _NOT_THERE) for key in _JOINTS]
    position = (*reading.twist, *(angle for angle, _ in known))
    behaviour = {BEHAVIOUR: f"{len(reading.faults)} faults"} if reading.faults else {}
    return Observation(
        t_ns=stamp_ns,
        position=position,
        stamp_ns=tuple(0 if math.isnan(value) else stamp_ns for value in position),
        velocity=(*(0.0 for _ in BASE), *(speed for _, speed in known)),
        sensors=sensors_of(reading),
        faults={**faults, **behaviour},
    )


def held_at(reading: Reading) -> Targets:
    """Return where a standing robot is held, by axis: the base at rest, each arm joint at its reading.
    None for a joint without one."""
    angles = (reading.joints.get(wire_name(key), _NOT_THERE)[0] for key in _JOINTS)
    return (*(0.0 for _ in BASE), *(None if math.isnan(angle) else angle for angle in angles))


def reason_moving(reading: Reading) -> str:
    """Return why the robot is not known to stand still; empty if it does."""
    if reading.motors is Motors.OFF:
        return ""
    if not reading.speed <= STILL:
        return f"not confirmed: it reports speed {reading.speed:.2f}"
    speed = _arm_speed(reading)
    if math.isnan(speed):
        return "not confirmed: its arm does not report its speed"
    return "" if speed <= STILL else f"not confirmed: its arm reports {speed:.2f} rad/s"


def _arm_speed(reading: Reading) -> float:
    """Return the speed of the fastest joint of arm and claw, rad/s; NaN if a joint does not report its
    speed. A joint that this robot lacks is at rest."""
    speeds = [abs(reading.joints.get(wire_name(key), _NOT_THERE)[1]) for key in _JOINTS]
    return math.nan if any(map(math.isnan, speeds)) else max(speeds)
