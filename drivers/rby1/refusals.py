"""Refusals of the RB-Y1 driver: its own codes, and one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode


class RBY1Code(RefusalCode):
    """See ``docs/refusals.md``."""

    EMERGENCY_STOP = (
        "emergency_stop",
        "an emergency stop button is pressed",
        "release the button, then call resume()",
    )
    POWER = "power", "a supply or a servo is off", "resume()"
    NOT_ENABLED = "not_enabled", "the control manager is not enabled", "resume()"
    DROPPED = "dropped", "the robot has dropped our command", "resume()"
    NO_LIMITS = "no_limits", "the robot has not reported its limits", "reconnect"
    NOT_RESET = "not_reset", "the fault could not be reset", "fix the cause of the fault, then try again"


_RESUME = "check the cause, then call resume()"
_RESET_AGAIN = "fix the cause of the fault, then try again"


# -- the emergency stop and faults


def emergency_stop() -> Refused:
    reason = "the emergency stop button is pressed"
    return Refused(RBY1Code.EMERGENCY_STOP, reason, "release the button, then call resume()", "pressed", "released")


def manager_fault(state: str) -> Refused:
    remedy = "fix its cause, then reset_fault_control_manager() and resume()"
    return Refused(Code.FAULT, f"the robot's control manager reports {state}", remedy, state, "no fault")


def fault_not_reset(reason: str, state: str) -> Refused:
    return Refused(RBY1Code.NOT_RESET, reason, _RESET_AGAIN, state)


def fault_remains(state: str) -> Refused:
    """Return the refusal of a reset that the robot has confirmed, although its control manager is not ready."""
    return Refused(RBY1Code.NOT_RESET, f"the control manager is {state}", _RESET_AGAIN, state)


# -- the power and the control manager


def no_power() -> Refused:
    return Refused(RBY1Code.POWER, "the motors have no power", _RESUME, "off", "on")


def servos_off() -> Refused:
    return Refused(RBY1Code.POWER, "servos are off", _RESUME, "off", "on")


def not_enabled(state: str, required: str) -> Refused:
    return Refused(RBY1Code.NOT_ENABLED, f"the control manager is {state}", _RESUME, state, required)


def command_dropped(reason: str) -> Refused:
    return Refused(RBY1Code.DROPPED, reason, _RESUME, reason, "RUNNING")


def unknown_limits(joints: int) -> Refused:
    return Refused(
        RBY1Code.NO_LIMITS, "the robot's own limits are not known", "connect again", "none", f"{joints} joints"
    )
