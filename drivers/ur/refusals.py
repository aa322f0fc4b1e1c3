"""Refusals of the UR driver: its own codes, and one function for each text."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode

from .protocol import RobotMode, SafetyMode, mode_name


class URCode(RefusalCode):
    """See ``docs/refusals.md``."""

    SAFETY_MODE = "safety_mode", "the robot is in a safety mode", "clear it on the pendant, then resume()"
    PAUSED = "paused", "the robot was paused on the pendant", "continue on the pendant"
    PROGRAM = "program", "the control script is not running", "resume()"


_UNLOCK: Mapping[int, str] = {
    SafetyMode.PROTECTIVE_STOP: "look at the arm, then unlock the protective stop on the pendant",
    SafetyMode.SAFEGUARD_STOP: "close the safeguard",
}


def wrong_robot_mode(mode: int) -> Refused:
    name, required = mode_name(RobotMode, mode), mode_name(RobotMode, RobotMode.RUNNING)
    remedy = "power on the arm and release its brakes on the pendant"
    return Refused(Code.ROBOT_MODE, f"robot is {name}", remedy, name, required)


def wrong_safety_mode(mode: int) -> Refused:
    name, remedy = mode_name(SafetyMode, mode), _UNLOCK.get(mode, "clear it on the pendant")
    return Refused(URCode.SAFETY_MODE, name, remedy, name, "NORMAL (1) or REDUCED (2)")


def script_paused() -> Refused:
    reason = "control script was paused on the pendant"
    return Refused(URCode.PAUSED, reason, "call resume()", limit="PLAYING")


def script_not_running(cause: str) -> Refused:
    """Return the refusal of a command while the control script does not run. ``cause`` may be empty."""
    reason = "control script is not running" + (f" ({cause})" if cause else "")
    return Refused(URCode.PROGRAM, reason, "call resume()", limit="PLAYING")


def speed_scaled_to_zero() -> Refused:
    return Refused(URCode.PAUSED, "the arm's speed is scaled to 0", "raise the speed slider on the pendant")
