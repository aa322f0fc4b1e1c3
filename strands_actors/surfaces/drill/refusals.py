"""The texts of the refusals that a drill reports when a robot gave no report itself: one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code


def not_resumed(within_s: float) -> Refused:
    return Refused(Code.NO_ANSWER, f"the robot was not resumed within {within_s:g} s")


def not_connected(failure: Exception) -> Refused:
    return Refused(Code.NOT_CONNECTED, str(failure))


def nothing_ran(reason: str) -> Refused:
    return Refused(Code.NOTHING_RAN, reason, verb="stop")
