"""The tool for all robots of the mesh: its verbs, and how a model's input is read. Pure.

A robot's own tool has the verbs of its driver. This tool has only what concerns every robot, so that a model can
find a robot, give it a task, and stop it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from strands_actors.contract.plain_numbers import as_python
from strands_actors.contract.shown import closest
from strands_actors.contract.stop_words import asks_for_stop
from strands_actors.kernel.messages import Refused

from . import refusals

NAME = "fleet"
LIST, STATUS, RUN, STOP, STOP_ALL = "list", "status", "run", "stop", "stop_all"
VERBS = {
    LIST: "all robots: type, state, who may command each, and whether it answers.",
    STATUS: "the state of one robot, or of all without robot.",
    RUN: "let a policy that is installed on the robot's computer control one robot. It answers when it has begun.",
    STOP: "make one robot safe. Without robot, all of them.",
    STOP_ALL: "make all robots safe.",
}
INPUTS: dict[str, dict[str, Any]] = {
    "robot": {"type": "string", "description": "The name of a robot, as list shows it."},
    "instruction": {"type": "string", "description": "The task for the policy, in words."},
    "policy": {"type": "string", "description": "The name of the policy, such as lerobot_local."},
    "seconds": {"type": "number", "description": "Longest duration of the task, up to 3600. Default: 30."},
}
TAKES: dict[str, tuple[str, ...]] = {
    LIST: (),
    STATUS: ("robot",),
    RUN: ("robot", "instruction", "policy", "seconds"),
    STOP: ("robot",),
    STOP_ALL: (),
}
REQUIRED = {RUN: ("robot", "instruction", "policy")}
TYPES: dict[str, type | tuple[type, ...]] = {"string": str, "number": (int, float)}
MAX_INPUTS = 16


class FleetCall(NamedTuple):
    """A call of the tool. ``robot`` is empty for all robots."""

    verb: str
    robot: str = ""
    inputs: Mapping[str, Any] = {}


def spec() -> dict[str, Any]:
    """Return the specification of the tool, for strands-agents and MCP."""
    action = {
        "type": "string",
        "enum": list(VERBS),
        "description": " ".join(f"{verb}: {about}" for verb, about in VERBS.items()),
    }
    return {
        "name": NAME,
        "description": (
            "All robots that can be reached. Each robot decides itself: what it must not do it refuses, and says "
            "what it would accept. A robot that does not answer is named."
        ),
        "inputSchema": {
            "json": {"type": "object", "properties": {"action": action, **INPUTS}, "required": ["action"]}
        },
    }


def read(tool_input: object) -> FleetCall | Refused:
    """Return the call for a model's input, or a refusal.

    A null counts as a missing input. A stop is accepted in any form (``contract/stop_words.py``), even with unknown
    inputs. If it names no robot in the declared form, it stops all.
    """
    names = ", ".join(VERBS)
    action = tool_input.get("action") if isinstance(tool_input, Mapping) else None
    verb = action.strip().lower() if isinstance(action, str) else None
    if verb not in VERBS and asks_for_stop(tool_input, NAME):
        return FleetCall(STOP_ALL)
    if not isinstance(tool_input, Mapping):
        return refusals.no_object(tool_input, names)
    robot = tool_input.get("robot")
    if verb in (STOP, STOP_ALL):
        return FleetCall(STOP, robot) if verb == STOP and isinstance(robot, str) and robot else FleetCall(STOP_ALL)
    if len(tool_input) > MAX_INPUTS:
        return refusals.too_many_inputs(len(tool_input), MAX_INPUTS)
    if verb not in VERBS:
        return refusals.unknown_verb(action, NAME, names)
    inputs = {key: as_python(value) for key, value in tool_input.items() if key != "action" and value is not None}
    return _refuse_inputs(verb, inputs) or FleetCall(
        verb, inputs.get("robot", ""), {key: value for key, value in inputs.items() if key != "robot"}
    )


def _refuse_inputs(verb: str, inputs: Mapping[str, Any]) -> Refused | None:
    takes = TAKES[verb]
    listed = ", ".join(takes) or "no input"
    for name, value in inputs.items():
        if name not in takes:
            return refusals.unknown_input(verb, name, next(iter(closest(name, takes)), None), listed)
        type_name = INPUTS[name]["type"]
        if not isinstance(value, TYPES[type_name]) or isinstance(value, bool):
            return refusals.wrong_type(verb, name, value, type_name)
    for name in REQUIRED.get(verb, ()):
        if not inputs.get(name):
            return refusals.missing_input(verb, name, listed)
    return None
