"""Convert a Spot's state to an observation, and judge whether the robot stands still. Pure: no I/O."""

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
_MISSING = (math.nan, 0.0)


def sensors_of(reading: Reading) -> dict[str, tuple[float, ...]]:
    """Return the sensor values that are not axes. Each name ends with its unit."""
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
    """Convert a robot state to an observation. ``stamp_ns`` is the time at which the state was new."""
    joints = [reading.joints.get(wire_name(key), _MISSING) for key in _JOINTS]
    position = (*reading.twist, *(angle for angle, _ in joints))
    behaviour = {BEHAVIOUR: f"{len(reading.faults)} faults"} if reading.faults else {}
    return Observation(
        t_ns=stamp_ns,
        position=position,
        stamp_ns=tuple(0 if math.isnan(value) else stamp_ns for value in position),
        velocity=(*(0.0 for _ in BASE), *(speed for _, speed in joints)),
        sensors=sensors_of(reading),
        faults={**faults, **behaviour},
    )


def held_at(reading: Reading) -> Targets:
    """Return the position of each axis of a standing robot: zero for the base, the measured
    position for each arm joint, None for a joint that was not measured."""
    angles = (reading.joints.get(wire_name(key), _MISSING)[0] for key in _JOINTS)
    return (*(0.0 for _ in BASE), *(None if math.isnan(angle) else angle for angle in angles))


def reason_moving(reading: Reading) -> str:
    """Return why the robot is not known to stand still; empty if it does."""
    if reading.motors is Motors.OFF:
        return ""
    if reading.motors is Motors.POWERING_ON:
        return "not confirmed: the motors are being powered on"
    if not reading.speed <= STILL:
        return f"not confirmed: the robot reports speed {reading.speed:.2f}"
    speed = _arm_speed(reading)
    if math.isnan(speed):
        return "not confirmed: the arm does not report its speed"
    return "" if speed <= STILL else f"not confirmed: the arm reports {speed:.2f} rad/s"


def _arm_speed(reading: Reading) -> float:
    """Return the speed of the fastest joint of arm and claw, rad/s; NaN if a joint does not report its
    speed. A joint that this robot lacks is at rest."""
    speeds = [abs(reading.joints.get(wire_name(key), _MISSING)[1]) for key in _JOINTS]
    return math.nan if any(map(math.isnan, speeds)) else max(speeds)
