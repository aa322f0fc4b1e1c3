"""Refusals that only the Stretch driver uses: the codes, and one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode

RUNSTOP_CAUSES = {
    "low_battery": ("the battery is low", "charge it"),
    "at_cliff": ("the base has met a cliff", "move it away, switch the robot off and on"),
    "tilted": ("the robot is tilted", "set it upright"),
    "high_current": ("the robot has drawn too much current", "remove what blocks the robot"),
}
"""Sensor: reason why the power board sets the runstop by itself, and first remedy. The board sets it again as long
as the reason lasts. It remembers a cliff until it is switched off."""


class StretchCode(RefusalCode):
    """See ``docs/refusals.md``."""

    CONTACT = (
        "contact",
        "a joint has met an obstacle, and its board has stopped it",
        "clear the joint's way, then resume()",
    )
    SAFETY_MODE = (
        "safety_mode",
        "a joint's board is in its safety mode",
        "check the board and its supply, then resume()",
    )
    RUNSTOP = "runstop", "the runstop is pressed", "release the runstop, then resume()"
    NO_WATCHDOG = "no_watchdog", "the wheels' velocity watchdog is off", "check the firmware"
    STRAFE = "strafe", "the base cannot strafe", "turn with wz, drive with vx"
    SOFT_LIMIT = "soft_limit", "a target is outside the present soft limits", "stay within the limits"
    NOT_HOMED = "not_homed", "a joint is not homed", "run the homing routine"
    WHEEL_SPEED = "wheel_speed", "a wheel would be too fast", "give a slower twist"


# -- the state of the robot


def runstop(cause: str) -> Refused:
    """Return the refusal because the runstop (the robot's stop button) is on.

    Args:
        cause: A key of ``RUNSTOP_CAUSES``; empty if the robot reports no cause.
    """
    reason = f"the robot sets its runstop: {RUNSTOP_CAUSES[cause][0]}" if cause else "the runstop is pressed"
    return Refused(StretchCode.RUNSTOP, reason, f"{runstop_remedy(cause)}, then resume()", "pressed")


def runstop_remedy(cause: str) -> str:
    """Return what to do until the runstop is off. ``cause`` is as in ``runstop``."""
    release = "release the runstop on the robot"
    return f"{RUNSTOP_CAUSES[cause][1]}, then {release}" if cause else release


def contact(joint: str, fault: str) -> Refused:
    reason = f"{joint} has met an obstacle, and its board has stopped it"
    return Refused(StretchCode.CONTACT, reason, "clear the joint's way, then call resume()", fault, "none")


def safety_mode(joint: str, fault: str) -> Refused:
    reason = f"{joint} is in the safety mode of its board"
    remedy = "check the board and its supply, then call resume()"
    return Refused(StretchCode.SAFETY_MODE, reason, remedy, fault, "none")


# -- joints


def outside_soft_limits(key: str, offered: str, unit: str, limit: str) -> Refused:
    reason = f"{key} {offered}{unit} is outside its present soft limits"
    return Refused(StretchCode.SOFT_LIMIT, reason, f"stay within {limit}", offered, limit)


def not_homed(key: str) -> Refused:
    remedy = "run the homing routine on the robot: stretch_robot_home.py"
    return Refused(StretchCode.NOT_HOMED, f"{key} is not homed", remedy, "not homed", "homed")


# -- the base


def vy_not_finite() -> Refused:
    return Refused(Code.NOT_FINITE, "vy is no finite number", "leave it out")


def sideways(vy_m_s: float) -> Refused:
    reason = f"vy is {vy_m_s:g} m/s, and this base cannot drive sideways"
    return Refused(StretchCode.STRAFE, reason, "turn with wz, drive with vx", f"{vy_m_s:g}", "0")


def wheel_too_fast(side: str, speed_m_s: float, limit_m_s: float, separation_m: float) -> Refused:
    return Refused(
        StretchCode.WHEEL_SPEED,
        f"the {side} wheel would run at {speed_m_s:.3f} m/s",
        f"keep |vx| + |wz| * {separation_m / 2:.3f} within {limit_m_s:g}",
        f"{abs(speed_m_s):.3f}",
        f"{limit_m_s:g}",
    )


def wheel_watchdog_off() -> Refused:
    return Refused(
        StretchCode.NO_WATCHDOG,
        "the wheels' velocity watchdog is off",
        "set enable_vel_watchdog: 1 for both wheels in the robot's YAML, then connect again",
        "off",
        "on",
    )


# -- the service set_soft_limits


def unknown_joint_argument(joint: str, joints: str) -> Refused:
    return Refused(Code.BAD_ARGUMENT, f"joint is {joint or 'missing'}", f"give one of {joints}", joint, joints)


def bad_soft_limits(joint: str, low: object, high: object, least: float, most: float) -> Refused:
    """Return the refusal of new limits. ``least`` and ``most`` are the ends of the joint's travel."""
    offered, limit = f"{low}..{high}"[:40], f"{least:.4f}..{most:.4f}"
    remedy = f"give low and high within {limit}, low below high"
    return Refused(Code.BAD_ARGUMENT, f"{joint} {offered}", remedy, offered, limit)
