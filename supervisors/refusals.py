"""The texts of refusals of stops, policies and recorders: one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

REMEDY = "look at the robot, and cut its power if it still moves"


# -- stops


def no_stop_answer(verb: str) -> Refused:
    return Refused(Code.NO_ANSWER, "no answer", REMEDY, verb=verb)


def unreachable(verb: str, reason: str, remedy: str, code: str) -> Refused:
    return Refused(code, reason, remedy, verb=verb)


def late_stopped(request: str, confirmed: str, remedy: str) -> Refused:
    """Return the refusal of a late request, after which the robot was stopped and every motor confirmed it."""
    return Refused(Code.TIMEOUT, f"{request}; {confirmed}", remedy)


def late_unconfirmed(request: str, motors: str) -> Refused:
    """Return the refusal of a late request, after which ``motors`` did not confirm the stop."""
    return Refused(Code.TIMEOUT, f"{request}; {motors} did not confirm the stop that followed", REMEDY)


def late_unreachable(request: str, problem: str) -> Refused:
    """Return the refusal of a late request, after which no process answered to the stop."""
    return Refused(Code.TIMEOUT, f"{request}; {problem}")


# -- the link to the robot, and its stop channels


def link_lost(reason: str) -> Refused:
    return Refused(Code.NOT_CONNECTED, reason)


def no_stop_channel(reason: str) -> Refused:
    return Refused(Code.NO_STOP_CHANNEL, reason)


# -- stop drills


def no_drill(reason: str, remedy: str) -> Refused:
    return Refused(Code.NO_DRILL, reason, remedy)


# -- policies


def silent_gate(failure: str) -> Refused:
    return Refused(Code.PUBLISH, f"the gate does not answer: {failure}")


# -- recorders


def other_format(recorder: int, robot: int) -> Refused:
    return Refused(
        Code.FORMAT, f"the recorder has format {recorder}, this robot has {robot}", "use the robot's version"
    )


def recording_given_up() -> Refused:
    reason = "the robot ended this recording early, and the last entries were not sent"
    return Refused(Code.GIVEN_UP, reason, "run the recorder on a less busy computer")


# -- faults that are made on request


def faults_not_allowed(variable: str) -> Refused:
    remedy = f"set the environment variable {variable}=1"
    return Refused(Code.NOT_ALLOWED, "faults are not allowed", remedy, verb="break")


def unknown_fault(fault: str) -> Refused:
    remedy = "use exception, exit, spin or leak"
    return Refused(Code.UNKNOWN_FAULT, f"{fault} is no known fault", remedy, verb="break")
