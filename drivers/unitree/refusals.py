"""The refusals of the Unitree drivers: their codes, and the texts, one function for each text."""

from __future__ import annotations

from strands_actors.contract.refusals import stale_report
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode

MAY_LET_GO = "a release was requested but not answered, so the robot may still carry it out"

_RELEASE = "call release_sport_mode() first. After that the robot no longer balances by itself"
_CHECK_BATTERY = "check the robot's battery topic"
_TRY_AGAIN = "check the robot, then try again"
_JOINTS_ELSEWHERE = "make it with level='low' to command its joints"


class UnitreeCode(RefusalCode):
    """See ``docs/refusals.md``."""

    FSM = "fsm", "the robot's state machine accepts no commands in this state", "select one of the named states"
    FSM_UNKNOWN = "fsm_unknown", "the robot does not report the state of its state machine", "check the robot"
    FSM_STALE = "fsm_stale", "the last report of the state machine is too old", "check the network"
    SPORT_MODE = "sport_mode", "the onboard mode is active", "release_sport_mode()"
    SPORT_MODE_UNKNOWN = "sport_mode_unknown", "the onboard mode is not known", "check the robot"
    SPORT_MODE_STALE = "sport_mode_stale", "the last report of the onboard mode is too old", "check the network"
    SPORT_MODE_RELEASED = "sport_mode_released", "the onboard mode was released", "select_sport_mode()"
    BATTERY_LOW = "battery_low", "the battery's charge is below the minimum", "charge the battery"
    BATTERY_UNKNOWN = "battery_unknown", "the battery's charge is not known", "check the robot"
    POSTURE = "posture", "the robot cannot walk from this posture", "call the service that is named"


# -- the state of a robot that gets commands for its joints


def no_low_state() -> Refused:
    reason = "no LowState yet, mode_machine unknown"
    return Refused(Code.NO_STATE, reason, "wait for the first LowState, or check the network")


def unknown_fsm(states: str) -> Refused:
    reason = "the FSM id is not known"
    return Refused(UnitreeCode.FSM_UNKNOWN, reason, "check that the robot has booted", "", states)


def stale_fsm(age_s: float, limit_s: float) -> Refused:
    remedy = "check the robot's sport service and the network"
    return stale_report(UnitreeCode.FSM_STALE, "FSM id", f"{age_s:.1f} s", f"{limit_s:.1f} s", remedy)


def unsuitable_fsm(state: float, word: str | None, states: str) -> Refused:
    """Return the refusal of joint commands in a state of the G1's state machine.

    Args:
        state: The number of the state.
        word: Its name, if it has one.
        states: The states in which joint commands are accepted.
    """
    shown = f"{state:g} ({word})" if word else f"{state:g}"
    reason = f"FSM {shown} does not accept low-level commands; needs 500, 501 or 801"
    remedy = "select one of these states on the robot's remote"
    return Refused(UnitreeCode.FSM, reason, remedy, f"{state:g}", states)


def unknown_sport_mode() -> Refused:
    reason = "the onboard mode is not known"
    return Refused(UnitreeCode.SPORT_MODE_UNKNOWN, reason, _RELEASE, "", "released")


def stale_sport_mode(age_s: float, limit_s: float) -> Refused:
    return stale_report(UnitreeCode.SPORT_MODE_STALE, "the onboard mode", f"{age_s:.1f} s", f"{limit_s:.1f} s")


def active_sport_mode(mode: str) -> Refused:
    reason = f"the onboard sport mode {mode} is still active"
    return Refused(UnitreeCode.SPORT_MODE, reason, _RELEASE, mode, "released")


def unknown_charge() -> Refused:
    reason = "the battery's charge is not known"
    return Refused(UnitreeCode.BATTERY_UNKNOWN, reason, _CHECK_BATTERY, "unknown", "a state of charge")


def stale_charge(age_s: float, limit_s: float) -> Refused:
    age = f"{age_s:.0f} s"
    reason = f"the battery's charge is {age} old (limit {limit_s:.0f} s)"
    return Refused(UnitreeCode.BATTERY_UNKNOWN, reason, _CHECK_BATTERY, age)


def low_charge(charge_pct: float, minimum_pct: float) -> Refused:
    charge, minimum = f"{charge_pct:.1f} %", f"{minimum_pct:.1f} %"
    reason = f"battery {charge} is below the minimum of {minimum}"
    return Refused(UnitreeCode.BATTERY_LOW, reason, "charge the battery", charge, minimum)


# -- services of a robot that gets commands for its joints


def joints_only(walks: bool) -> Refused:
    """Return the refusal of a service for walking.

    Args:
        walks: True if this robot can be made with another level at which it walks.
    """
    reason = "this robot is commanded joint by joint (level='low')"
    if walks:
        return Refused(Code.LEVEL, reason, "make it with level='sport' to walk", "low", "sport")
    return Refused(Code.LEVEL, reason, "command its joints, because this package cannot make it walk", "low")


def simulator_without_mode() -> Refused:
    return Refused(UnitreeCode.SPORT_MODE, "a simulator has no onboard mode", "command its joints", "", "")


def unanswered_release(mode: str) -> Refused:
    reason = f"{mode!r} is still active; {MAY_LET_GO}"
    remedy = "make the robot lie down with its remote, and wait"
    return Refused(UnitreeCode.SPORT_MODE, reason, remedy, mode, "released")


def failed_release(mode: str, attempts: int) -> Refused:
    reason = f"{mode!r} is still active after {attempts} attempts"
    remedy = "make the robot lie down or damp with its remote, then try again"
    return Refused(UnitreeCode.SPORT_MODE, reason, remedy, mode, "released")


# -- walking: the robot's state


def released_sport_mode() -> Refused:
    reason = "the sport mode is released: the joints are commanded one by one, and the robot does not balance"
    remedy = "end the program that commands the joints, then call select_sport_mode()"
    return Refused(UnitreeCode.SPORT_MODE_RELEASED, reason, remedy, "released")


def unreported_mode(source: str) -> Refused:
    return Refused(Code.MODE_UNKNOWN, f"no {source} yet", "check that the robot's sport service runs")


def stale_mode(source: str, age_s: float, limit_s: float) -> Refused:
    return stale_report(Code.MODE_STALE, f"the last {source}", f"{age_s:.1f} s", f"{limit_s:g} s")


def posture_without_walking(mode: str, modes: str, service: str) -> Refused:
    """Return the refusal of a velocity that the robot would ignore.

    Args:
        mode: The robot's mode.
        modes: The modes in which it walks.
        service: The service that leads to one of them; empty if the robot only has to end its motion.
    """
    remedy = f"call {service}() first" if service else "wait until this motion has ended"
    return Refused(UnitreeCode.POSTURE, f"the robot is in the mode {mode}", remedy, mode, modes)


def refused_velocity(error: str) -> Refused:
    return Refused(Code.REFUSED_BY_ROBOT, f"the robot refuses to move: {error}", _TRY_AGAIN, error)


# -- walking: joints and services


def onboard_joint(key: str, axes: str) -> Refused:
    return Refused(Code.LEVEL, f"the onboard controller commands {key}", _JOINTS_ELSEWHERE, key, axes)


def walks_only() -> Refused:
    """Return the refusal of a service for joint commands."""
    reason = "this robot walks by its sport mode (level='sport'), which keeps the joints"
    return Refused(Code.LEVEL, reason, _JOINTS_ELSEWHERE, "sport", "low")


def impossible_posture(service: str, mode: str, modes: str) -> Refused:
    reason = f"{service}() is not possible in the mode {mode}"
    return Refused(UnitreeCode.POSTURE, reason, f"bring the robot to one of these modes: {modes}", mode, modes)


def refused_request(error: str) -> Refused:
    return Refused(Code.REFUSED_BY_ROBOT, f"the robot refuses: {error}", _TRY_AGAIN)
