"""The texts of the wire's refusals of services: one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

_LATER = "try again later"


def service_without_link(service: str) -> Refused:
    return Refused(Code.BUSY, "the link was lost", _LATER, verb=service)


def other_running_service(service: str) -> Refused:
    return Refused(Code.BUSY, "another service is being carried out", _LATER, verb=service)


def stopped_meanwhile() -> Refused:
    return Refused(Code.STOPPED, "the robot was stopped meanwhile", "run the service again")


def not_finished(within_s: float) -> Refused:
    reason = f"the robot did not finish within {within_s:g} s"
    return Refused(Code.TIMEOUT, reason, "check the robot")
