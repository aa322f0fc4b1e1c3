"""Checks that refuse commands to a Crazyflie in its reported state. Pure: no I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import axis_gates
from strands_actors.contract.driver import (
    Candidate,
    Condition,
    ConditionCheck,
    GateCheck,
    GateState,
    OnResume,
    Reason,
)
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused

from . import refusals
from .protocol import Battery, Bit, Flight, Position
from .robots import VZ, Z

Row = tuple[float, ...]

SETTLED_DEG = 15.0
"""Tilt above which the drone does not stand well enough to take off [assumed]."""
BATTERY_AGE_S = 2.0
"""Age above which a voltage counts as missing. The drone sends it ten times a second [assumed]."""


def sensors_of(flight: Flight, position: Position, position_age_s: float, hover_s: float) -> dict[str, Row]:
    """Return the sensor values of a report. Each name ends with its unit."""
    return {
        "xyz_m": (position.x_m, position.y_m, flight.z_m),
        "rpy_rad": (flight.roll_rad, flight.pitch_rad, position.yaw_rad),
        "velocity_m_s": flight.velocity_m_s,
        "battery_v": (position.battery_v,),
        "battery_state": (float(position.battery_state),),
        "supervisor": (float(flight.bits),),
        "hover_s": (hover_s,),
        "position_age_s": (position_age_s,),
    }


def bits_in(sensors: Mapping[str, Row]) -> Bit | None:
    """Return the flags of the drone's supervisor; None if they were never received."""
    row = sensors.get("supervisor")
    return None if row is None else Bit(int(row[0]))


# -- conditions that must be true of the robot, for any command


def conditions_of(battery_v: float, hover_s: float) -> tuple[Condition, ...]:
    """Return the conditions (checks that must pass while the drone is commanded), in the order in which they are
    checked. Each failed condition leads to its own safe state: for example, a tumbled drone switches its motors
    off, and a drone with a low battery lands.

    Args:
        battery_v: Voltage below which the drone lands.
        hover_s: Longest hover without a command.
    """
    return (
        Condition(_locked, Reason.FAULT, SafeState.LIMP, always=True),
        Condition(_upset, Reason.FAULT, SafeState.LIMP, always=True),
        Condition(_battery(battery_v), Reason.FAULT, SafeState.LAND, always=True),
        Condition(_hovering(hover_s), Reason.FAULT, SafeState.LAND, always=True),
        Condition(_flying, Reason.FAULT, SafeState.LAND, on_resume=OnResume.STAY_ARMED),
    )


def _locked(observation: Observation, now_ns: int) -> Refused | None:
    bits = bits_in(observation.sensors)
    if bits is None or Bit.LOCKED not in bits:
        return None
    return refusals.locked("locked")


def _upset(observation: Observation, now_ns: int) -> Refused | None:
    bits = bits_in(observation.sensors)
    if bits is None or not bits & (Bit.TUMBLED | Bit.CRASHED):
        return None
    if Bit.TUMBLED in bits:
        return refusals.tumbled()
    return refusals.crashed()


def _battery(floor_v: float) -> ConditionCheck:
    def battery(observation: Observation, now_ns: int) -> Refused | None:
        bits = bits_in(observation.sensors)
        if bits is None or not bits.airborne:
            # Check the battery only in flight. On the floor ``takeoff`` checks it.
            return None
        return _refuse_battery(observation.sensors, floor_v)

    return battery


def _refuse_battery(sensors: Mapping[str, Row], floor_v: float) -> Refused | None:
    (age_s,) = sensors.get("position_age_s", (0.0,))
    if age_s > BATTERY_AGE_S:
        return refusals.stale_battery(age_s, BATTERY_AGE_S)
    (volts,) = sensors.get("battery_v", (math.nan,))
    (state,) = sensors.get("battery_state", (float(Battery.BATTERY),))
    if volts >= floor_v and state not in (Battery.LOW_POWER, Battery.SHUTDOWN):
        return None
    if volts >= floor_v:
        return refusals.low_battery_by_firmware(volts, floor_v)
    return refusals.low_battery(volts, floor_v)


def _hovering(longest_s: float) -> ConditionCheck:
    def hovering(observation: Observation, now_ns: int) -> Refused | None:
        (hover_s,) = observation.sensors.get("hover_s", (0.0,))
        return None if hover_s <= longest_s else refusals.hovered_too_long(longest_s)

    return hovering


def _flying(observation: Observation, now_ns: int) -> Refused | None:
    bits = bits_in(observation.sensors)
    if bits is None:
        return refusals.no_supervisor_report()
    return None if bits.airborne else refusals.not_flying()


# -- gates: each checks one command


def gates_of(axes: Sequence[Axis], state_ttl_s: float) -> tuple[GateCheck, ...]:
    return (*axis_gates(axes, state_ttl_s), _within_heights(axes[Z].limits))


def _within_heights(heights_m: tuple[float, float]) -> GateCheck:
    """Return a gate that refuses to climb above the ceiling, or to descend so far that the drone's own downwash
    disturbs it."""
    low, high = heights_m

    def within_heights(candidate: Candidate, state: GateState) -> Refused | None:
        climb, height_m = candidate.values[VZ], state.observation.position[Z]
        if climb > 0 and height_m >= high:
            return refusals.too_high_to_climb(climb, height_m, low, high)
        if climb < 0 and height_m <= low:
            return refusals.too_low_to_sink(climb, height_m, low, high)
        return None

    return within_heights


# -- taking off


def takeoff_refusal(bits: Bit | None, sensors: Mapping[str, Row], floor_v: float) -> Refused | None:
    """Return why the drone may not take off now; None if it may."""
    if bits is None:
        return refusals.silent_supervisor()
    if Bit.LOCKED in bits:
        return refusals.locked()
    if bits & (Bit.TUMBLED | Bit.CRASHED):
        return refusals.tumbled_or_crashed()
    refusal = _refuse_battery(sensors, floor_v)
    if refusal is not None or bits.airborne:
        return refusal
    if not bits & (Bit.ARMED | Bit.CAN_BE_ARMED):
        return refusals.cannot_arm()
    tilt_deg = max(abs(math.degrees(angle)) for angle in sensors["rpy_rad"][:2])
    if tilt_deg > SETTLED_DEG:
        return refusals.tilted(tilt_deg, SETTLED_DEG)
    return None
