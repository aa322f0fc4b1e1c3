"""The texts of the refusals when a robot's processes do not answer: one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code


def unreachable(verb: str, failure: Exception) -> Refused:
    return Refused(Code.UNREACHABLE, str(failure), "call resume() when the robot is back", verb=verb)


def late_status(verb: str, waited_ms: float) -> Refused:
    reason = f"the process that talks to the robot has not answered for {waited_ms:g} ms"
    return Refused(Code.NO_ANSWER, reason, "try again: the host may be busy", verb=verb)


def silent_processes(verb: str) -> Refused:
    remedy = "an operator's resume() starts it again"
    return Refused(Code.NOT_CONNECTED, "the robot's processes do not answer", remedy, verb=verb)


# -- a robot of another program


def unconfirmed_stop(failure: Exception) -> Refused:
    return Refused(Code.UNCONFIRMED, f"neither the wire process nor the root process answers ({failure})")


def resume_unanswered(failure: Exception) -> Refused:
    return Refused(
        Code.UNREACHABLE,
        f"the process that talks to the robot does not answer ({failure})",
        "wait some seconds for its restart, then try again",
    )
