"""Refusal codes (the reasons for refusing a command) that only the Stretch driver uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


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
