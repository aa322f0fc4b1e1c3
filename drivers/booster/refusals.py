"""The refusals of the T1 driver: its codes, and the texts, one function for each text."""

from __future__ import annotations

from strands_actors.contract.refusals import stale_report
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode

_TO_WALKING = "call change_mode('walking') first"


class BoosterCode(RefusalCode):
    """See ``docs/refusals.md``."""

    FALLEN = "fallen", "the robot lies on the ground, or falls", "stand it up"
    CUSTOM_MODE = "custom_mode", "another program has set custom mode", "switch the robot to walking mode"
    TOO_FEW_MOTORS = "too_few_motors", "the robot reports fewer motors than a T1 has", "check that it is a T1"
    UPPER_BODY = "upper_body", "the robot has not given its arms to this program", "call enable_upper_body()"
    UNKNOWN_MODE = "unknown_mode", "there is no such mode", "use one of the listed modes"
    FALL_UNKNOWN = "fall_unknown", "the robot has not reported its fall state", "check the robot's fall_down topic"
    FALL_STALE = (
        "fall_stale",
        "the last report of the robot's fall state is too old",
        "check the robot and the network",
    )
    NOT_OURS = "not_ours", "only the onboard controller may move the joint", "use one of the listed joints"
    NOT_A_JOINT = "not_a_joint", "a speed of the base is given as a joint", "call move(vx, vy, vyaw)"
    NOT_CONFIRMED = (
        "not_confirmed",
        "the robot has not answered a request and may still carry it out",
        "check what the robot does",
    )
    STATUS = "status", "the robot answered a request with an error", "check the robot"


# -- the robot's state, for any command


def unknown_fall_state() -> Refused:
    reason = "the robot has not reported its fall state"
    return Refused(BoosterCode.FALL_UNKNOWN, reason, "check the robot's fall_down topic")


def stale_fall_state(age_s: float, limit_s: float) -> Refused:
    return stale_report(
        BoosterCode.FALL_STALE, "the last report of the fall state", f"{age_s:.1f} s", f"{limit_s:.1f} s"
    )


def fallen(state: str) -> Refused:
    remedy = "wait until the robot has got up (IS_READY)"
    return Refused(BoosterCode.FALLEN, f"the robot reports {state}", remedy, state, "IS_READY")


def unreported_mode() -> Refused:
    return Refused(Code.MODE_UNKNOWN, "the robot does not report the mode", "check that the robot's service runs")


def stale_mode(age_s: float, limit_s: float) -> Refused:
    return stale_report(Code.MODE_STALE, "the last report of the mode", f"{age_s:.1f} s", f"{limit_s:.1f} s")


def custom_mode(modes: str) -> Refused:
    reason = "in custom mode this program commands every motor, and the legs would lose their torque"
    remedy = "switch it to walking mode with its remote control"
    return Refused(BoosterCode.CUSTOM_MODE, reason, remedy, "custom", modes)


def no_state() -> Refused:
    reason = "no state has arrived yet (topic LowState)"
    return Refused(Code.NO_STATE, reason, "wait for the first state, or check the network")


# -- joints


def too_few_motors(count: float, last_slot: int) -> Refused:
    motors, limit = f"{count:.0f}", f"more than {last_slot}"
    reason = f"the robot reports {motors} motors, fewer than a T1 has"
    return Refused(BoosterCode.TOO_FEW_MOTORS, reason, "check that it is a T1", motors, limit)


def upper_body_not_handed_over() -> Refused:
    reason = "the onboard controller still has the upper body"
    return Refused(BoosterCode.UPPER_BODY, reason, "call enable_upper_body() first")


def onboard_joint(key: str, slot: int, keys: str, is_head: bool) -> Refused:
    """Return the refusal of a joint that only the robot's own controller may drive."""
    reason = f"{key} (slot {slot}) is moved only by the onboard controller"
    remedy = "call rotate_head(pitch, yaw)" if is_head else f"commandable: {keys}"
    return Refused(BoosterCode.NOT_OURS, reason, remedy, key, keys)


def base_speed(key: str, keys: str) -> Refused:
    reason = f"{key} is a speed of the base, not a joint"
    return Refused(BoosterCode.NOT_A_JOINT, reason, "call move(vx, vy, vyaw)", key, keys)


# -- services


def argument_not_finite(argument: str, value: str) -> Refused:
    return Refused(Code.NOT_FINITE, f"{argument} is {value}", "give a finite number", value, "a finite number")


def argument_past_limit(argument: str, value: float, limit: str) -> Refused:
    reason = f"{argument}={value:.4g} is outside {limit}"
    return Refused(Code.PAST_LIMIT, reason, "give a value within this range", f"{value:.4g}", limit)


def unknown_mode(mode: str, modes: str) -> Refused:
    return Refused(BoosterCode.UNKNOWN_MODE, f"mode is {mode!r}", f"use one of {modes}", mode, modes)


def mode_without_walking(mode: str, modes: str) -> Refused:
    return Refused(Code.MODE, f"the robot does not walk in {mode} mode", _TO_WALKING, mode, modes)


def mode_without_balance(mode: str, modes: str) -> Refused:
    return Refused(Code.MODE, f"in {mode} mode no controller balances the robot", _TO_WALKING, mode, modes)


def unconfirmed_request(limit_s: float) -> Refused:
    reason = "the robot has not answered the request and may still carry it out"
    limit = f"within {limit_s:g} s"
    return Refused(BoosterCode.NOT_CONFIRMED, reason, "check what the robot does", "no answer", limit)


def failed_request(error: str, status: int) -> Refused:
    return Refused(BoosterCode.STATUS, f"the robot answered: {error}", "check the robot", str(status), "0")
