"""The refusals of drivers of robots with motors: their codes, and the texts, one function for each text."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.contract.refusals import or_move_to, stale_report
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode

CLEAR_IT = "clear the cause, then try again"
_STAY_WITHIN = "stay within this range"


class MotorCode(RefusalCode):
    """Codes of refused commands to motors. ``docs/refusals.md`` explains each code."""

    NO_Q = "no_q", "a joint's command has no position", "give q in radians"
    TOO_STRONG = "too_strong", "a torque is past its limit", "stay within the limit that is named"
    GAIN = "gain", "a gain is past its limit", "stay within the limit that is named"
    FAULT = "fault", "a motor reports a fault", CLEAR_IT
    VOLTAGE = "voltage", "a servo's supply is too low or too high", CLEAR_IT
    TEMPERATURE = "temperature", "a servo is too hot", CLEAR_IT
    ALERT = (
        "alert",
        "a servo reports a hardware alert",
        "clear the cause, reboot the servo with the arm supported, then stop and resume",
    )
    WATCHDOG = "watchdog", "a servo's bus watchdog has tripped", "stop and resume to clear it"
    WATCHDOG_OFF = (
        "watchdog_off",
        "a servo's bus watchdog is off",
        "end the program that has switched it off, then stop and resume",
    )
    LIMP = "limp", "a motor has no torque", "take the load off, then stop and resume to energise it again"


# -- actions of motors that take position, speed, torque and gains (``motor_targets``)


def no_q(key: str, parts: str, rows: str) -> Refused:
    """Return the refusal of a joint's command that has no position.

    Args:
        key: The joint.
        parts: The values that the command has.
        rows: The values that a command may have.
    """
    reason = f"the command of {key} has no q (position)"
    return Refused(MotorCode.NO_Q, reason, "give q in radians. dq, tau, kp and kd are optional", parts, rows)


def unknown_row(key: str, row: str, rows: str) -> Refused:
    return Refused(Code.UNKNOWN_KEY, f"{key}.{row} is not known", f"use {rows}", row, rows)


def named_twice(key: str, spelling: str) -> Refused:
    both = f"{key} and {spelling}"
    return Refused(Code.BOTH_SPELLINGS, f"{both} are both given for one joint", "send only one", both)


def unnamed_not_finite(key: str, value: str) -> Refused:
    """Return the refusal because a joint that the action does not name has a target that is no finite number."""
    remedy = "wait until the robot reports its position, or send a finite q for this joint"
    return Refused(Code.NOT_FINITE, f"{key} is {value}", remedy, value, "a finite number")


def speed_past_limit(key: str, speed_rad_s: float, limit_rad_s: float) -> Refused:
    speed, limit = f"{speed_rad_s:.4g}", f"-{limit_rad_s:g}..{limit_rad_s:g} rad/s"
    return Refused(Code.TOO_FAST, f"{key}.dq={speed} is outside {limit}", _STAY_WITHIN, speed, limit)


def torque_past_limit(key: str, torque_nm: float, limit_nm: float) -> Refused:
    torque, limit = f"{torque_nm:.4g}", f"-{limit_nm:g}..{limit_nm:g} Nm"
    return Refused(MotorCode.TOO_STRONG, f"{key}.tau={torque} is outside {limit}", _STAY_WITHIN, torque, limit)


def gain_past_limit(key: str, gain: str, value: float, most: float) -> Refused:
    offered, limit = f"{value:.4g}", f"0..{most:g}"
    return Refused(MotorCode.GAIN, f"{key}.{gain}={offered} is outside {limit}", _STAY_WITHIN, offered, limit)


# -- targets of arms without a speed limit in their controller (``step_gates``)


def step_too_long(
    key: str, step_rad: float, limit_rad: float, rate_hz: float, target: float | None = None
) -> Refused:
    """Return the refusal of a step that is too long for one period. ``target``: see ``or_move_to``."""
    step, limit = f"{step_rad:.5g}", f"{limit_rad:.5g}"
    reason = f"{key} steps {step} rad at once, the limit is {limit} at {rate_hz:.4g} Hz"
    return Refused(Code.TOO_FAST, reason, or_move_to(f"step at most {limit} rad", key, target), step, limit)


def target_ahead(key: str, lead_rad: float, limit_rad: float, target: float | None = None) -> Refused:
    """Return the refusal of a target that is too far from the measured position. ``target``: see ``or_move_to``."""
    lead, limit = f"{lead_rad:.4g}", f"{limit_rad:.4g}"
    reason = f"the target of {key} is {lead} rad from its position, the limit is {limit}"
    remedy = or_move_to("send targets no faster than the robot can follow", key, target)
    return Refused(Code.RUNS_AHEAD, reason, remedy, lead, limit)


def jump(key: str, distance_deg: float, target_deg: float, limit_deg: float) -> Refused:
    """Return the refusal of a single command to a servo that would go too far at its top speed."""
    distance, limit = f"{distance_deg:.1f}", f"{limit_deg:g}"
    reason = f"{key} would go {distance} deg at full speed, limit {limit} deg"
    alternative = f'move_to({{"{key}": {target_deg:.4g}}}, seconds=2)'
    remedy = f"use {alternative}, or make the robot with a larger max_jump"
    return Refused(Code.JUMP, reason, remedy, distance, limit)


# -- reports of a robot or its motors


def stale_low_state(age_ms: float, limit_ms: float) -> Refused:
    return stale_report(Code.STALE, "last LowState", f"{age_ms:.0f} ms", f"{limit_ms:.0f} ms")


def voltage_out_of_range(axis: str, supply_v: float, low_v: float, high_v: float) -> Refused:
    supply, low, high = f"{supply_v:.1f}", f"{low_v:.1f}", f"{high_v:.1f}"
    reason = f"{axis} has a supply of {supply} V"
    return Refused(MotorCode.VOLTAGE, reason, f"supply {low}..{high} V", supply, f"{low}..{high}")


def too_hot(axis: str, temperature_c: float, limit_c: float) -> Refused:
    temperature, limit = f"{temperature_c:.0f}", f"{limit_c:.0f}"
    reason = f"{axis} is at {temperature} deg C"
    return Refused(MotorCode.TEMPERATURE, reason, f"let it cool below {limit} deg C", temperature, limit)


def motor_fault(code: MotorCode, key: str, faults: Sequence[str]) -> Refused:
    """Return the refusal of a command to a motor that reports faults.

    Args:
        code: The code of the fault that decides.
        key: The joint.
        faults: The names of all its faults. ``limp``: the motor has no torque.
    """
    others = ", ".join(fault for fault in faults if fault != "limp")
    if code == MotorCode.LIMP or "limp" in faults:
        state = f"is limp ({others})" if others else "is limp"
    else:
        state = f"reports {others}"
    return Refused(code, f"{key} {state}", code.remedy, ", ".join(faults), "no fault")


# -- the hand of an arm (``hand``)


def hand_not_named(given: str, axis: str) -> Refused:
    return Refused(Code.EMPTY, f"{given} is given without {axis}", f"name {axis} in the same action", given, axis)
