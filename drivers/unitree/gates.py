"""The conditions, as pure functions: checks of the state of a legged robot that must pass while its joints are
commanded.

The checks of a command's values are in ``common/kit/motor_targets``.
"""

from __future__ import annotations

from strands_actors.contract.driver import Condition, ConditionCheck, OnResume
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.refusals import stale_low_state
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals
from .robots import Model
from .rpc import FSM_WORDS

CONTROL_HZ = 500.0
CONTROL_S = 1 / CONTROL_HZ

HANDSHAKE_FSM = (500, 501, 801)
FSM_TTL_S = 1.0
MODE_TTL_S = 1.0
BATTERY_TTL_S = 10.0
"""Longest age of the battery's charge. Some robots publish it on a separate topic, at a low rate [assumed]."""
BATTERY_FLOOR_PCT = 15.0


# -- conditions: checked before every setpoint, and continuously while a setpoint is in force


def conditions(
    model: Model, floor_pct: float, state_ttl_s: float, simulator: bool = False
) -> tuple[Condition, ...]:
    """Return the conditions, in the order in which they are checked. A condition is a check of the robot's state
    that must pass while its joints are commanded. The first one that fails is reported.

    For Unitree's own simulator (``simulator``) only the age of its states can be checked.
    """
    if simulator:
        return (Condition(stale(state_ttl_s), is_silence=True),)
    # All robots except the G1 have a service that switches off (releases) the onboard controller.
    others = Condition(sport_mode, on_resume=OnResume.STAY_ARMED)
    handshake = Condition(fsm) if model.handshake == "fsm" else others
    charge = (Condition(check) for check in (battery_reported, battery_above(floor_pct)))
    return Condition(stale(state_ttl_s), is_silence=True), handshake, *charge


def stale(ttl_s: float) -> ConditionCheck:
    ttl_ns = round(ttl_s * NS)

    def stale(observation: Observation, now_ns: int) -> Refused | None:
        stamp_ns = observation.stamp_ns[0]
        if stamp_ns == 0:
            return refusals.no_low_state()
        age_ns = now_ns - stamp_ns
        if age_ns <= ttl_ns:
            return None
        return stale_low_state(age_ns / 1e6, ttl_s * 1e3)

    return stale


_HANDSHAKE = ", ".join(map(str, HANDSHAKE_FSM))


def fsm_in_control(number: float) -> str:
    """Return the state of a G1 if this state controls the robot instead of our commands; otherwise empty."""
    return "" if number in HANDSHAKE_FSM else f"FSM {number:g}"


def mode_in_control(mode: str) -> str:
    """Return the onboard mode, for people, if one controls the robot instead of our commands; otherwise empty."""
    return f"sport mode {mode!r}" if mode else ""


def fsm(observation: Observation, now_ns: int) -> Refused | None:
    """G1: refuse joint commands unless its state machine (FSM) is in a state in which the robot balances."""
    reported = observation.sensors.get("fsm")
    if reported is None:
        return refusals.unknown_fsm(_HANDSHAKE)
    number, requested_s = reported
    age_s = now_ns / NS - requested_s
    if age_s > FSM_TTL_S:
        return refusals.stale_fsm(age_s, FSM_TTL_S)
    if number in HANDSHAKE_FSM:
        return None
    return refusals.unsuitable_fsm(number, FSM_WORDS.get(round(number)), _HANDSHAKE)


def sport_mode(observation: Observation, now_ns: int) -> Refused | None:
    """Robots other than the G1: refuse unless the onboard controller is released (switched off).

    The robot must have reported this within the last ``MODE_TTL_S``.
    """
    reported = observation.sensors.get("sport_mode_released")
    if reported is None:
        return refusals.unknown_sport_mode()
    released, requested_s = reported
    age_s = now_ns / NS - requested_s
    if age_s > MODE_TTL_S:
        return refusals.stale_sport_mode(age_s, MODE_TTL_S)
    if released:
        return None
    return refusals.active_sport_mode(observation.faults.get("sport_mode", ""))


def battery_reported(observation: Observation, now_ns: int) -> Refused | None:
    stamp_s = observation.sensors.get("battery_stamp_s")
    if stamp_s is None:
        return refusals.unknown_charge()
    age_s = now_ns / NS - stamp_s[0]
    if age_s > BATTERY_TTL_S:
        return refusals.stale_charge(age_s, BATTERY_TTL_S)
    return None


def battery_above(floor_pct: float) -> ConditionCheck:
    def battery_above(observation: Observation, now_ns: int) -> Refused | None:
        reported = observation.sensors.get("battery_pct")
        if reported is None or reported[0] >= floor_pct:
            return None
        return refusals.low_charge(reported[0], floor_pct)

    return battery_above
