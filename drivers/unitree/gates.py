"""The conditions, as pure functions: checks of the state of a legged robot that must pass while its joints are
commanded.

The checks of a command's values are in ``common/kit/motor_targets``.
"""

from __future__ import annotations

from strands_actors.contract.driver import Condition, ConditionCheck, OnResume
from strands_actors.contract.wire import Observation
from strands_actors.drivers.unitree.refusals import UnitreeCode
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

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
            reason = "no LowState yet, mode_machine unknown"
            return Refused(Code.NO_STATE, reason, "wait for the first LowState, or check the network")
        age_ns = now_ns - stamp_ns
        if age_ns <= ttl_ns:
            return None
        age, limit = f"{age_ns / 1e6:.0f} ms", f"{ttl_s * 1e3:.0f} ms"
        reason = f"last LowState is {age} old (limit {limit})"
        return Refused(Code.STALE, reason, "check the robot and the network", age, limit)

    return stale


_HANDSHAKE = ", ".join(map(str, HANDSHAKE_FSM))


def fsm(observation: Observation, now_ns: int) -> Refused | None:
    """G1: refuse joint commands unless its state machine (FSM) is in a state in which the robot balances."""
    reported = observation.sensors.get("fsm")
    if reported is None:
        reason = "the FSM id is not known"
        return Refused(UnitreeCode.FSM_UNKNOWN, reason, "check that the robot has booted", "", _HANDSHAKE)
    number, requested_s = reported
    age_s = now_ns / NS - requested_s
    if age_s > FSM_TTL_S:
        reason = f"FSM id is {age_s:.1f} s old (limit {FSM_TTL_S:.1f} s)"
        age, limit = f"{age_s:.1f} s", f"{FSM_TTL_S:.1f} s"
        return Refused(UnitreeCode.FSM_STALE, reason, "check the robot's sport service and the network", age, limit)
    if number in HANDSHAKE_FSM:
        return None
    word = FSM_WORDS.get(round(number))
    shown = f"{number:g} ({word})" if word else f"{number:g}"
    reason = f"FSM {shown} does not accept low-level commands; needs 500, 501 or 801"
    return Refused(
        UnitreeCode.FSM, reason, "select one of these states on the robot's remote", f"{number:g}", _HANDSHAKE
    )


def sport_mode(observation: Observation, now_ns: int) -> Refused | None:
    """Robots other than the G1: refuse unless the onboard controller is released (switched off).

    The robot must have reported this within the last ``MODE_TTL_S``.
    """
    reported = observation.sensors.get("sport_mode_released")
    remedy = "call release_sport_mode() first. After that the robot no longer balances by itself"
    if reported is None:
        return Refused(UnitreeCode.SPORT_MODE_UNKNOWN, "the onboard mode is not known", remedy, "", "released")
    released, requested_s = reported
    age_s = now_ns / NS - requested_s
    if age_s > MODE_TTL_S:
        reason = f"the onboard mode is {age_s:.1f} s old (limit {MODE_TTL_S:.1f} s)"
        age = f"{age_s:.1f} s"
        return Refused(
            UnitreeCode.SPORT_MODE_STALE, reason, "check the robot and the network", age, f"{MODE_TTL_S:.1f} s"
        )
    if released:
        return None
    name = observation.faults.get("sport_mode", "")
    return Refused(
        UnitreeCode.SPORT_MODE, f"the onboard sport mode {name} is still active", remedy, name, "released"
    )


def battery_reported(observation: Observation, now_ns: int) -> Refused | None:
    stamp_s = observation.sensors.get("battery_stamp_s")
    if stamp_s is None:
        reason = "the battery's charge is not known"
        return Refused(
            UnitreeCode.BATTERY_UNKNOWN, reason, "check the robot's battery topic", "unknown", "a state of charge"
        )
    age_s = now_ns / NS - stamp_s[0]
    if age_s > BATTERY_TTL_S:
        reason = f"the battery's charge is {age_s:.0f} s old (limit {BATTERY_TTL_S:.0f} s)"
        return Refused(UnitreeCode.BATTERY_UNKNOWN, reason, "check the robot's battery topic", f"{age_s:.0f} s")
    return None


def battery_above(floor_pct: float) -> ConditionCheck:
    def battery_above(observation: Observation, now_ns: int) -> Refused | None:
        reported = observation.sensors.get("battery_pct")
        if reported is None or reported[0] >= floor_pct:
            return None
        charge = f"{reported[0]:.1f} %"
        reason = f"battery {charge} is below the minimum of {floor_pct:.1f} %"
        return Refused(UnitreeCode.BATTERY_LOW, reason, "charge the battery", charge, f"{floor_pct:.1f} %")

    return battery_above
