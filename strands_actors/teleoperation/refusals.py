"""The texts of the refusals of teleoperation: one function for each text."""

from __future__ import annotations

from strands_actors.contract.shown import shown
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

OPERATE = "operate"


def runs_elsewhere(robot: str) -> Refused:
    reason = f"{robot} is run by another host"
    return Refused(Code.ELSEWHERE, reason, "run the teleoperation on that host", verb="teleoperate")


# -- an operator's input


def not_the_deadman() -> Refused:
    return Refused(
        Code.GRIPPER_DEADMAN,
        "the dead-man of this teleoperation is the leader's gripper",
        'squeeze the gripper twice, or start again with attach_teleop(leader, deadman="key")',
        verb=OPERATE,
    )


def bad_held(held: object) -> Refused:
    reason, limit = f"held is {shown(held)}", "True or False"
    return Refused(Code.BAD_ARGUMENT, reason, f"give {limit}", shown(held), limit, verb=OPERATE)


def unknown_axis(key: str, closest_key: str | None, robot: str, axes: str) -> Refused:
    hint = "" if closest_key is None else f" ({closest_key!r}?)"
    reason, limit = f"{shown(key)} is no axis of {robot}{hint}", f"one of {axes or 'none'}"
    return Refused(Code.UNKNOWN_JOINT, reason, f"give {limit}", shown(key), limit, verb=OPERATE)


def bad_rate(key: str, rate: object) -> Refused:
    reason, limit = f"{key} is {shown(rate)}", "a rate in -1..1"
    return Refused(Code.BAD_RATE, reason, f"give {limit}", shown(rate), limit, verb=OPERATE)
