"""Reasons to refuse a command that only the Franka driver has."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class FrankaCode(RefusalCode):
    """See ``docs/refusals.md``."""

    MOTION_ENDED = "motion_ended", "the controller ended the motion", "resume()"
    SUCCESS_RATE = (
        "success_rate",
        "too few commands reach the controller in time",
        "see what else the computer and the network do",
    )
    NOT_ALL_JOINTS = "not_all_joints", "an arm is moved by all its joints", "name all of them"
    NOT_RECOVERED = (
        "not_recovered",
        "the controller refuses to recover",
        "release the stop button, or clear the error in Desk",
    )
