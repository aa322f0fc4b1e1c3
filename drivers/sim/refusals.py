"""The refusals of simulated robots: their own codes, and one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode


class SimCode(RefusalCode):
    """See ``docs/refusals.md``."""

    NOT_HELD = "not_held", "a joint is not held by the simulation", "resume()"
    WIRE = "wire", "the simulation refuses it", "follow the text"


def too_large(key: str, value: str, unit: str, most: str) -> Refused:
    reason = f"{key} {value}{unit} is too large for the physics"
    return Refused(Code.PAST_TRAVEL, reason, f"give a target within {most} of the joint's zero", value, most)


def not_held(axis: str, state: str, by_other_program: bool) -> Refused:
    """Return the refusal to move an axis that does not follow the simulation.

    Args:
        axis: The axis.
        state: Why it does not follow.
        by_other_program: True if another program drives it.
    """
    first_step = "stop the robot in that program, then " if by_other_program else ""
    remedy = f"{first_step}call stop() and resume() here"
    return Refused(SimCode.NOT_HELD, f"{axis} is {state}", remedy, state, "held by the simulation")


def energised() -> Refused:
    return Refused(Code.LIVE, "the robot is energised", "call stop() first")


def refused_by_simulation(reason: str) -> Refused:
    return Refused(SimCode.WIRE, reason)
