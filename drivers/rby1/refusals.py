"""Refusal codes (the reasons for refusing a command) that only the RB-Y1 driver uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


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
