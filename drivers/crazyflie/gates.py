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
from strands_actors.drivers.crazyflie.refusals import CrazyflieCode
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

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
    return Refused(
        CrazyflieCode.LOCKED, "the drone is locked after an emergency stop", "switch it off and on", "locked"
    )


def _upset(observation: Observation, now_ns: int) -> Refused | None:
    bits = bits_in(observation.sensors)
    if bits is None or not bits & (Bit.TUMBLED | Bit.CRASHED):
        return None
    if Bit.TUMBLED in bits:
        return Refused(CrazyflieCode.TUMBLED, "the drone has tumbled", "put it on its feet", "tumbled")
    return Refused(CrazyflieCode.CRASHED, "the drone has crashed", "switch it off and on", "crashed")


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
        reason, limit = f"the drone has not reported its battery for {age_s:.1f} s", f"{BATTERY_AGE_S:g} s"
        return Refused(Code.BATTERY, reason, "check radio and power", f"{age_s:.1f}", limit)
    (volts,) = sensors.get("battery_v", (math.nan,))
    (state,) = sensors.get("battery_state", (float(Battery.BATTERY),))
    if volts >= floor_v and state not in (Battery.LOW_POWER, Battery.SHUTDOWN):
        return None
    limit = f"{floor_v:.1f} V"
    if volts >= floor_v:
        reason, remedy = f"the firmware reports a low battery, at {volts:.2f} V", "charge it"
    else:
        reason, remedy = f"the battery has only {volts:.2f} V", f"charge it above {limit}"
    return Refused(Code.BATTERY, reason, remedy, f"{volts:.2f}", limit)


def _hovering(longest_s: float) -> ConditionCheck:
    def hovering(observation: Observation, now_ns: int) -> Refused | None:
        (hover_s,) = observation.sensors.get("hover_s", (0.0,))
        if hover_s <= longest_s:
            return None
        limit = f"{longest_s:g} s"
        return Refused(
            CrazyflieCode.HOVERING,
            f"the drone hovered without a command for {limit}",
            "take off again",
            limit=limit,
        )

    return hovering


def _flying(observation: Observation, now_ns: int) -> Refused | None:
    bits = bits_in(observation.sensors)
    if bits is None:
        return Refused(
            Code.NO_OBSERVATION, "the drone's supervisor has not reported yet", "wait for its first report"
        )
    if bits.airborne:
        return None
    return Refused(
        CrazyflieCode.NOT_FLYING, "the drone stands on the floor with its motors off", "call takeoff() first"
    )


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
            reason, remedy = f"at {height_m:.2f} m, past {high:g}", "sink, or give z"
        elif climb < 0 and height_m <= low:
            reason, remedy = f"at {height_m:.2f} m, below {low:g}", "call land()"
        else:
            return None
        return Refused(Code.PAST_TRAVEL, f"vz {climb:g} m/s {reason}", remedy, f"{climb:g}", f"{low:g}..{high:g}")

    return within_heights


# -- taking off


def takeoff_refusal(bits: Bit | None, sensors: Mapping[str, Row], floor_v: float) -> Refused | None:
    """Return why the drone may not take off now; None if it may."""
    if bits is None:
        return Refused(Code.NO_OBSERVATION, "the drone's supervisor does not answer", "check radio and power")
    if Bit.LOCKED in bits:
        return Refused(CrazyflieCode.LOCKED, "the drone is locked after an emergency stop", "switch it off and on")
    if bits & (Bit.TUMBLED | Bit.CRASHED):
        return Refused(
            CrazyflieCode.TUMBLED, "the drone has tumbled or crashed", "put it on its feet, switch it off and on"
        )
    refusal = _refuse_battery(sensors, floor_v)
    if refusal is not None or bits.airborne:
        return refusal
    if not bits & (Bit.ARMED | Bit.CAN_BE_ARMED):
        return Refused(CrazyflieCode.CANNOT_ARM, "the drone's supervisor does not allow arming", "check the drone")
    tilt_deg = max(abs(math.degrees(angle)) for angle in sensors["rpy_rad"][:2])
    if tilt_deg > SETTLED_DEG:
        limit = f"{SETTLED_DEG:g} degrees"
        return Refused(
            CrazyflieCode.TILTED,
            f"the drone is tilted by {tilt_deg:.0f} degrees",
            "put it on a level floor",
            limit=limit,
        )
    return None
