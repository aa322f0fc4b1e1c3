"""What is made of a Spot's reading: an observation, and where it stands. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping

from strands_actors.contract.wire import Observation

from .gates import BEHAVIOUR
from .protocol import Motors, Reading
from .robots import ARM, BASE, CLAW, LEG_SENSORS, LEGS, wire_name

Targets = tuple[float | None, ...]

STILL = 0.05
"""m/s and rad/s: below, it stands [assumed]."""

_JOINTS = (*ARM, CLAW)
_NOT_THERE = (math.nan, 0.0)


def sensors_of(reading: Reading) -> dict[str, tuple[float, ...]]:
    """Return what is read beside the axes, by name, unit in the name."""
    told = {
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
    return {**told, **{LEG_SENSORS[key]: (joint[0],) for key, joint in legs if joint is not None}}


def observe(reading: Reading, stamp_ns: int, faults: Mapping[str, str]) -> Observation:
    """Return a reading in the words of the contract. ``stamp_ns``: when it was new."""
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
    """Return where a robot that stands still is held, by axis: its base at rest, its arm where it
    was read; None for a joint that was not."""
    angles = (reading.joints.get(wire_name(key), _NOT_THERE)[0] for key in _JOINTS)
    return (*(0.0 for _ in BASE), *(None if math.isnan(angle) else angle for angle in angles))


def why_moving(reading: Reading) -> str:
    """Return why it is not known to stand still; empty: it is."""
    if reading.motors is Motors.OFF:
        return ""
    if not reading.speed <= STILL:
        return f"not confirmed: it reports speed {reading.speed:.2f}"
    speed = _arm_speed(reading)
    if math.isnan(speed):
        return "not confirmed: its arm does not report its speed"
    return "" if speed <= STILL else f"not confirmed: its arm reports {speed:.2f} rad/s"


def _arm_speed(reading: Reading) -> float:
    """Return how fast the quickest joint of arm and claw turns, rad/s; NaN: one does not say. A
    joint that this robot has not is at rest."""
    speeds = [abs(reading.joints.get(wire_name(key), _NOT_THERE)[1]) for key in _JOINTS]
    return math.nan if any(map(math.isnan, speeds)) else max(speeds)
