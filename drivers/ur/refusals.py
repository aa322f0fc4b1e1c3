"""Reasons to refuse a command that only the UR driver has."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class URCode(RefusalCode):
    """See ``docs/refusals.md``."""

    SAFETY_MODE = "safety_mode", "the robot is in a safety mode", "clear it on the pendant, then resume()"
    PAUSED = "paused", "the robot was paused on the pendant", "continue on the pendant"
    PROGRAM = "program", "the control script is not running", "resume()"
