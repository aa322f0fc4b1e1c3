"""Refusal codes (the reasons for refusing a command) that only the Robotiq driver uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class RobotiqCode(RefusalCode):
    """See ``docs/refusals.md``."""

    NOT_ACTIVATED = "not_activated", "the gripper is not activated", "resume()"
