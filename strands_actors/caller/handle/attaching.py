"""Make a handle of a robot that a host keeps, for ``Robot(name, attach=True)`` and ``open_robot``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from strands_actors.contract.loading import load
from strands_actors.surfaces.agents.approval import APPROVE_S, Approval, Approve, approval_of

from ..processes.plan import Plan
from ..resolve.attached import attached_plan, check_keywords


class Attachment(NamedTuple):
    """The parts of a handle of a robot that a host keeps."""

    plan: Plan
    approval: Approval
    arm: bool


async def attachment(
    name: str,
    given: Mapping[str, Any],
    arm: bool,
    approve: Approve | None,
    guarded: tuple[str, ...],
    approve_within_s: float,
) -> Attachment:
    """Ask the robot's root process for its settings, and combine them with those of the handle.

    Args:
        name: Name of the robot.
        given: The other keywords that the user gave.
        arm: As in ``Robot``. False also if the host's file says so.
        approve: As in ``Robot``. None: the function that the host's file names.
        guarded: As in ``Robot``. The names in the host's file are guarded, too.
        approve_within_s: As in ``Robot``. The default: the time in the host's file.

    Raises:
        ConnectionError: No host keeps such a robot, or it does not answer.
        TypeError: Only the host can use a keyword.
    """
    check_keywords(name, dict(given))
    theirs = await attached_plan(name)
    if approve is None and theirs.approve:
        approve = load(theirs.approve)
    if approve_within_s == APPROVE_S and theirs.approve_within_s is not None:
        approve_within_s = theirs.approve_within_s
    approval = approval_of(theirs.plan.driver_class, (*theirs.guarded, *guarded), approve, approve_within_s)
    return Attachment(theirs.plan, approval, arm and theirs.arm)
