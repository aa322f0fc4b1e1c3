"""Refusals of the Kinova driver: its own codes, and one function for each text."""

from __future__ import annotations

from strands_actors.contract.refusals import or_move_to
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode


class KinovaCode(RefusalCode):
    """See ``docs/refusals.md``."""

    STOPPED = "stopped", "the driver has stopped the arm by itself", "resume()"
    ARM_STATE = "arm_state", "the arm is not ready", "make it ready on the base's web page"
    BASE_IN_FAULT = "base_in_fault", "the base is in fault", "clear the fault, then reconnect"


def too_fast(
    key: str,
    speed_rad_s: float,
    period_ms: float,
    most_rad: float,
    limit_rad_s: float,
    target: float | None = None,
) -> Refused:
    """Return the refusal of a target that needs too high a speed.

    Args:
        key: The joint.
        speed_rad_s: The speed that reaches the target within one control period.
        period_ms: The control period.
        most_rad: The greatest distance of a target from the measured position.
        limit_rad_s: The greatest speed of the joint.
        target: See ``or_move_to``.
    """
    reason = f"{key} needs {speed_rad_s:.4g} rad/s to reach the target within {period_ms:.3g} ms"
    remedy = or_move_to(f"send a target at most {most_rad:.5f} rad from the measured position", key, target)
    return Refused(Code.TOO_FAST, reason, remedy, f"{speed_rad_s:.4g}", f"{limit_rad_s:.4g}")


def base_in_fault(fault_bank: int, state: str, required: str) -> Refused:
    reason = f"base in fault (bank 0x{fault_bank:x})"
    return Refused(KinovaCode.BASE_IN_FAULT, reason, "clear the fault, then reconnect", state, required)


def arm_not_ready(state: str, required: str) -> Refused:
    reason = f"the arm is in state {state}"
    return Refused(KinovaCode.ARM_STATE, reason, "make it ready on the base's web page", state, required)


def low_level_servoing(state: str) -> Refused:
    reason = "another client has set low-level servoing"
    return Refused(KinovaCode.ARM_STATE, reason, "call resume() to set single-level servoing", state)


def stopped(reason: str) -> Refused:
    return Refused(KinovaCode.STOPPED, reason, "call resume()", reason)
