"""Whether somebody on the mesh may have the lease. Pure."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.failsafe import WRITABLE, Mode
from strands_actors.supervisors.gate.lease import is_given_back
from strands_actors.supervisors.gate.messages import Status


def refuse_by_mode(status: Status, resumed_epoch: int) -> Refused | None:
    """Who comes over the mesh to a robot that holds must resume it first, unless it holds because
    somebody on the mesh wanted it to, or because its writer gave the lease back for others to have.
    ``resumed_epoch``: in which the first was last so."""
    if status.locked_by:
        return Refused(Code.LOCKED_OUT, f"e-stopped by {status.locked_by}", "resume lifts the lockout")
    if status.mode not in WRITABLE:
        cause = f" ({status.cause})" if status.cause else ""
        return Refused(Code.DISARMED, f"the robot is {status.mode}{cause}", "resume it first")
    wanted = status.epoch == resumed_epoch or is_given_back(status.lapse, status.holder)
    if status.mode == Mode.HOLDING and not wanted:
        return Refused(Code.HOLDING, f"the robot holds ({status.cause})", "resume it first")
    return None
