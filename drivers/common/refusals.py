"""Refusals of motors, on every wire that has them."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class MotorCode(RefusalCode):
    """See ``docs/refusals.md``."""

    NO_Q = "no_q", "a joint's command has no position", "give q in radians"
    TOO_STRONG = "too_strong", "a torque is past its limit", "stay within the limit that is named"
    GAIN = "gain", "a gain is past its limit", "stay within the limit that is named"
    VOLTAGE = "voltage", "a servo's supply is too low or too high", "check the supply"
    TEMPERATURE = "temperature", "a servo is too hot", "let it cool"
    ALERT = (
        "alert",
        "a servo reports a hardware alert",
        "clear the cause, then reboot the servo with the arm supported",
    )
    WATCHDOG = "watchdog", "a servo's bus watchdog has tripped", "stop and resume to clear it"
    WATCHDOG_OFF = (
        "watchdog_off",
        "a servo's bus watchdog is off",
        "end the program that switched it off, then resume()",
    )
    LIMP = "limp", "a servo has no torque", "resume()"
