"""Refusals of this wire alone."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class URCode(RefusalCode):
    """See ``docs/refusals.md``."""

    SAFETY_MODE = "safety_mode", "the robot is in a safety mode", "mend it at the robot, then resume()"
    PAUSED = "paused", "the robot was paused on the pendant", "go on there"
    PROGRAM = "program", "no control script runs", "resume()"
