"""Refusal codes that the drivers of all robots with motors use."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode

CLEAR_IT = "clear the cause, then try again"


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
