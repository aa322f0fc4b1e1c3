"""Decide if a sender on the mesh may have the lease. Pure."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.failsafe import WRITABLE, Mode
from strands_actors.supervisors.gate.lease import is_given_back
from strands_actors.supervisors.gate.messages import Status


def refuse_by_mode(status: Status, resumed_epoch: int) -> Refused | None:
    """Return a refusal of a lease by the robot's mode.

    A robot that holds must be resumed first, so that a link which was cut and has healed moves nothing.
    There are two exceptions: the hold was a regular end of a motion from the mesh, or the writer released
    the lease for others.

    Args:
        status: The robot's status.
        resumed_epoch: The epoch in which the robot was last resumed over the mesh, or held by a regular
            end of a motion from the mesh.
    """
    if status.locked_by:
        return Refused(Code.LOCKED_OUT, f"e-stopped by {status.locked_by}", "resume lifts the lockout")
    if status.mode not in WRITABLE:
        cause = f" ({status.cause})" if status.cause else ""
        return Refused(Code.DISARMED, f"the robot is {status.mode}{cause}", "resume it first")
    regular = status.epoch == resumed_epoch or is_given_back(status.lapse, status.holder)
    if status.mode == Mode.HOLDING and not regular:
        return Refused(Code.HOLDING, f"the robot holds ({status.cause})", "resume it first")
    return None
