"""The texts of the root's refusals: one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

_LOOK = "look at the robot"


# -- stops


def silent_processes(failure: str) -> Refused:
    reason = f"neither the wire process nor the root process answers ({failure})"
    return Refused(Code.UNCONFIRMED, reason, _LOOK)


def stop_not_reported() -> Refused:
    return Refused(Code.UNCONFIRMED, "no process reported the stop", _LOOK)


# -- stop channels


def no_reserve(missing: str) -> Refused:
    reason = f"the root process could not stop the robot: {missing}"
    return Refused(Code.NO_RESERVE, reason, "close other programs")


def port_not_passed(error: str) -> Refused:
    reason = f"the port cannot be passed to the standby process: {error}"
    return Refused(Code.NO_DESCRIPTOR, reason, "run ulimit -n 1024 first")


def link_closed() -> Refused:
    return Refused(Code.NO_STOP_CHANNEL, "the wire process has closed the link to the robot")


def no_standby() -> Refused:
    return Refused(Code.NO_STANDBY, "there is no standby process", "wait until a new one has been started")


# -- policies


def running_policy() -> Refused:
    return Refused(Code.RUNNING, "a policy is already running", "call stop_task() first")


def last_policy_not_ended() -> Refused:
    return Refused(Code.BUSY, "the process of the last policy has not ended yet", "try again")


def policy_not_started(error: str) -> Refused:
    return Refused(Code.NO_PROCESS, f"the policy process could not be started: {error}", "try again")
