"""Refusal codes that only the xArm driver has."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class XArmCode(RefusalCode):
    """See ``docs/refusals.md``."""

    ERROR = "error", "the controller holds an error", "clear it at the arm, then resume()"
    STATE = "state", "the arm is paused or stopped", "resume()"
