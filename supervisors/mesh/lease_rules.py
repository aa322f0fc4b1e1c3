"""Decide if a sender on the mesh may have the lease. Pure."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.failsafe import WRITABLE, Mode
from strands_actors.supervisors.gate.lease import is_lease_released
from strands_actors.supervisors.gate.messages import Status

from . import refusals


def refuse_by_mode(status: Status, resumed_epoch: int) -> Refused | None:
    """Return a refusal of a lease if the robot's mode does not permit one; otherwise None.

    A robot that holds must be resumed first, so that nothing moves when an interrupted link is connected again.
    There are two exceptions: the hold was the planned end of a motion from the mesh, or the last writer released
    its lease.

    Args:
        status: The robot's status.
        resumed_epoch: The value of the epoch (a counter of stops and holds) when the robot was last resumed over
            the mesh, or held at the planned end of a motion from the mesh.
    """
    if status.locked_by:
        return refusals.locked_out(status.locked_by)
    if status.mode not in WRITABLE:
        return refusals.not_writable(status.mode, status.cause)
    regular = status.epoch == resumed_epoch or is_lease_released(status.lapse, status.holder)
    if status.mode == Mode.HOLDING and not regular:
        return refusals.holding(status.cause)
    return None
