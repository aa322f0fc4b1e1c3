"""Turn a model's input into a call of a declared verb, or a refusal. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from strands_actors.contract.agent_verbs import undeclared, verbs_of
from strands_actors.contract.driver import Driver, Service
from strands_actors.contract.plain_numbers import as_python
from strands_actors.contract.shown import closest, shown
from strands_actors.contract.stop_words import asks_for_stop
from strands_actors.contract.tool_spec import tool_spec
from strands_actors.contract.tool_verbs import ToolVerb
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

Kind = Literal["read", "motion", "stop"]

TOOL = "tool"
"""The verb in a refusal of an input without a known verb."""
MAX_INPUTS = 64
"""Most inputs of a call. No verb takes so many."""

_TYPES: Mapping[str, tuple[type, ...]] = {
    "array": (list, tuple),
    "object": (Mapping,),
    "number": (int, float),
    "boolean": (bool,),
    "string": (str,),
}


@dataclass(frozen=True)
class Call:
    """A declared verb with inputs of the declared types.

    Attributes:
        verb: The verb.
        inputs: The inputs by name.
        moves: True for a service that leads to motion.
        asks: True for a service that its driver does not declare for agents, so that an operator is asked.
        means: The command of an action, if the driver has translated the inputs.
    """

    verb: ToolVerb
    inputs: Mapping[str, Any] = field(default_factory=dict)
    moves: bool = False
    asks: bool = False
    means: Mapping[str, float] | None = None

    @property
    def kind(self) -> Kind:
        """Return the kind of the call. Switching torque off is a stop."""
        match self.verb.does:
            case "stop":
                return "stop"
            case "action" | "move_to":
                return "motion"
            case "service":
                return "motion" if self.moves else "read"
            case "torque":
                return "motion" if self.inputs["enabled"] else "stop"
        return "read"

    @property
    def held_s(self) -> Any:
        """Return for how many seconds the command is repeated; None if it is sent once."""
        return self.inputs.get(self.verb.lasts) if self.verb.lasts else None

    @property
    def action(self) -> dict[str, Any]:
        """Return the command of an ``action``, or the targets of a ``move_to``."""
        if self.verb.does == "move_to":
            return dict(self.inputs["targets"])
        return self.verb.command(self.inputs) if self.means is None else dict(self.means)


def read(driver: Driver, given: object, tool_name: str = "") -> Call | Refused:
    """Return the call for a model's input, or a refusal.

    A null counts as an input that is not given. A stop accepts any extra input, and any form
    (``contract/stop_words.py``).

    Args:
        driver: The driver of the robot.
        given: The input as it was sent.
        tool_name: The name of the tool, which a text that asks for a stop may contain.
    """
    verbs = verbs_of(driver)
    names = ", ".join(verb.name for verb in verbs)
    action_given = given.get("action") if isinstance(given, Mapping) else None
    name_given = action_given.strip().lower() if isinstance(action_given, str) else None
    verb = next((verb for verb in verbs if verb.name == name_given), None)
    if verb is None and asks_for_stop(given, f"{driver.robot} {tool_name}"):
        verb = _stop_of(driver)
    if verb is not None and verb.does == "stop":
        return Call(verb)
    if not isinstance(given, Mapping):
        return Refused(
            Code.BAD_INPUT, f"the input is {shown(given)}", f"give an object with action: {names}", verb=TOOL
        )
    if verb is not None and verb.does == "torque" and as_python(given.get("enabled")) is False:
        return Call(verb, {"enabled": False})  # This is a stop, too, so other inputs are ignored.
    if len(given) > MAX_INPUTS:
        return Refused(Code.BAD_INPUT, f"it has {len(given)} inputs", f"give at most {MAX_INPUTS}", verb=TOOL)
    if all(value is None for value in given.values()):  # An empty input asks for the status.
        verb = next((verb for verb in verbs if verb.name == "status"), None)
    if verb is None:
        if isinstance(name_given, str) and (refused := _refuse_elsewhere(driver, name_given)):
            return refused
        why = (
            "no action is given"
            if action_given is None
            else f"{shown(action_given)} is not a verb of {driver.robot}"
        )
        return Refused(Code.UNKNOWN_VERB, why, f"use {names}", shown(action_given), names, verb=TOOL)
    inputs = {name: as_python(value) for name, value in given.items() if name != "action" and value is not None}
    if refused := _refuse_inputs(verb, inputs):
        return refused
    if verb.does == "action":
        action = driver.action_of(verb, inputs)
        return action.about(verb.name) if isinstance(action, Refused) else Call(verb, inputs, means=action)
    asks = verb.does == "service" and verb.name in undeclared(driver)
    moves = verb.does == "service" and (asks or is_motion(driver.SERVICES[verb.name]))
    return Call(verb, inputs, moves, asks and not driver.SIMULATED)


def _refuse_elsewhere(driver: Driver, name: str) -> Refused | None:
    """Return the refusal of a service that the robot has only in another mode; None if it has no service of
    this name."""
    refused = driver.check_service(name, {})
    return refused.about(name) if refused is not None and refused.code != Code.UNKNOWN_SERVICE else None


def _stop_of(driver: Driver) -> ToolVerb:
    return min((verb for verb in driver.TOOL_VERBS if verb.does == "stop"), key=lambda verb: verb.name != "stop")


def is_motion(service: Service) -> bool:
    """Return True for a service that moves the robot, or switches its motors' power. Only the robot's own
    program may call it without an approval."""
    return service.moves or service.powers or service.acts


def _refuse_inputs(verb: ToolVerb, inputs: Mapping[str, Any]) -> Refused | None:
    takes = ", ".join(verb.inputs) or "no input"
    for name, value in inputs.items():
        if name not in verb.inputs:
            close = closest(name, verb.inputs)
            hint = f" ({close[0]!r}?)" if close else ""
            why = f"it takes no {shown(name)}{hint}"
            return Refused(Code.UNKNOWN_INPUT, why, f"it takes {takes}", shown(name), takes, verb=verb.name)
        kind = verb.inputs[name]["type"]
        if not isinstance(value, _TYPES[kind]) or (isinstance(value, bool) and kind != "boolean"):
            why = f"{name} is {shown(value)}"
            return Refused(Code.BAD_INPUT, why, f"give it as {kind}", shown(value), kind, verb=verb.name)
    for name in verb.required:
        if name not in inputs:
            return Refused(Code.BAD_INPUT, f"{name} is missing", f"it takes {takes}", "", takes, verb=verb.name)
    return None


__all__ = ["Call", "Kind", "is_motion", "read", "tool_spec"]
