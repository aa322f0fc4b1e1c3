"""The texts of the refusals of an agent's tool call: one function for each text."""

from __future__ import annotations

from strands_actors.contract.shown import shown
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

TOOL = "tool"
"""The verb in a refusal of an input without a known verb."""

# -- the whole input


def no_object(tool_input: object, verbs: str) -> Refused:
    remedy = f"give an object whose key action is one of {verbs}"
    return Refused(Code.BAD_INPUT, f"the input is {shown(tool_input)}", remedy, verb=TOOL)


def too_many_inputs(count: int, most: int) -> Refused:
    return Refused(Code.BAD_INPUT, f"the call has {count} inputs", f"give at most {most}", verb=TOOL)


def unknown_verb(action: object, robot: str, verbs: str) -> Refused:
    """Return the refusal of a call whose key ``action`` names no verb. ``action`` is None if the key is missing."""
    reason = "no action is given" if action is None else f"{shown(action)} is not a verb of {robot}"
    return Refused(Code.UNKNOWN_VERB, reason, f"use {verbs}", shown(action), verbs, verb=TOOL)


# -- the inputs of a verb


def unknown_input(verb: str, name: str, closest_name: str | None, inputs: str) -> Refused:
    hint = "" if closest_name is None else f" ({closest_name!r}?)"
    reason = f"there is no input {shown(name)}{hint}"
    return Refused(Code.UNKNOWN_INPUT, reason, f"use {inputs}", shown(name), inputs, verb=verb)


def wrong_type(verb: str, name: str, value: object, type_name: str) -> Refused:
    reason, remedy = f"{name} is {shown(value)}", f"give {name} as {type_name}"
    return Refused(Code.BAD_INPUT, reason, remedy, shown(value), type_name, verb=verb)


def missing_input(verb: str, name: str, inputs: str) -> Refused:
    return Refused(Code.BAD_INPUT, f"{name} is missing", f"give {inputs}", "", inputs, verb=verb)


# -- permission to move


def no_motion(verb: str, remedy: str) -> Refused:
    return Refused(Code.NO_MOTION, "this tool does not allow motion", remedy, verb=verb)


def guards_nothing(verb: str, reason: str) -> Refused:
    return Refused(Code.GUARD, reason, "correct guarded= where the robot is made", verb=verb)
