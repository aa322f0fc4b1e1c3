"""Turn a model's input into a call of a verb that the driver declares, or into a refusal. No I/O."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from strands_actors.contract.agent_verbs import undeclared, verbs_of
from strands_actors.contract.driver import Driver, Service
from strands_actors.contract.plain_numbers import as_python
from strands_actors.contract.shown import closest
from strands_actors.contract.stop_words import asks_for_stop
from strands_actors.contract.tool_spec import tool_spec
from strands_actors.contract.tool_verbs import POSE_INPUTS, ToolVerb
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from . import refusals

Kind = Literal["read", "motion", "stop"]

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
    """A call of a verb that the driver declares for the robot's tool, with inputs of the declared types.

    Attributes:
        verb: The verb, such as ``move_to``.
        inputs: The inputs of the verb, by name.
        moves: True if the call runs a service that moves the robot.
        needs_approval: True if an operator is asked, whatever ``guarded`` names: the call energises a real robot,
            or runs a service that its driver does not declare for agents.
        targets: The targets by axis, if the driver has translated the inputs of an action. Otherwise None.
    """

    verb: ToolVerb
    inputs: Mapping[str, Any] = field(default_factory=dict)
    moves: bool = False
    needs_approval: bool = False
    targets: Mapping[str, float] | None = None

    @property
    def kind(self) -> Kind:
        """Return whether the call reads, moves or stops. A call that switches torque off is a stop."""
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
        """Return the time in seconds for which the command is repeated, or None if it is sent once."""
        return self.inputs.get(self.verb.lasts) if self.verb.lasts else None

    @property
    def action(self) -> dict[str, Any]:
        """Return the command for the robot's axes, as values by axis. For a ``move_to`` these are its
        targets, which a motion to a pose does not have."""
        if self.verb.does == "move_to":
            return dict(self.inputs.get("targets", {}))
        return self.verb.command(self.inputs) if self.targets is None else dict(self.targets)


def read(driver: Driver, tool_input: object, tool_name: str = "") -> Call | Refused:
    """Return the call for a model's input, or a refusal.

    A null counts as a missing input. A stop is accepted in any form (``contract/stop_words.py``), even with
    unknown inputs.

    Args:
        driver: The driver of the robot.
        tool_input: The input as it was sent.
        tool_name: The name of the tool. A text such as "stop NAME" is a stop, too.
    """
    verbs = verbs_of(driver)
    names = ", ".join(verb.name for verb in verbs)
    action_name = tool_input.get("action") if isinstance(tool_input, Mapping) else None
    requested_verb = action_name.strip().lower() if isinstance(action_name, str) else None
    verb = next((verb for verb in verbs if verb.name == requested_verb), None)
    if verb is None and asks_for_stop(tool_input, f"{driver.robot} {tool_name}"):
        verb = _stop_of(driver)
    if verb is not None and verb.does == "stop":
        return Call(verb)
    if not isinstance(tool_input, Mapping):
        return refusals.no_object(tool_input, names)
    if verb is not None and verb.does == "torque" and as_python(tool_input.get("enabled")) is False:
        return Call(verb, {"enabled": False})  # Switching torque off is a stop, so other inputs are ignored.
    if len(tool_input) > MAX_INPUTS:
        return refusals.too_many_inputs(len(tool_input), MAX_INPUTS)
    if all(value is None for value in tool_input.values()):  # An empty input is a request for the status.
        verb = next((verb for verb in verbs if verb.name == "status"), None)
    if verb is None:
        if isinstance(requested_verb, str) and (refused := _refuse_elsewhere(driver, requested_verb)):
            return refused
        return refusals.unknown_verb(action_name, driver.robot, names)
    inputs = {
        name: as_python(value) for name, value in tool_input.items() if name != "action" and value is not None
    }
    if refused := _refuse_inputs(verb, inputs):
        return refused
    if verb.does == "action":
        action = driver.action_of(verb, inputs)
        return action.about(verb.name) if isinstance(action, Refused) else Call(verb, inputs, targets=action)
    is_undeclared = verb.does == "service" and verb.name in undeclared(driver)
    moves = verb.does == "service" and (is_undeclared or is_motion(driver.SERVICES[verb.name]))
    # Energising is a resume. A person may have stopped the robot, so an agent does not decide about it alone.
    needs_approval = is_undeclared or verb.does == "torque"
    return Call(verb, inputs, moves, needs_approval and not driver.SIMULATED)


def _refuse_elsewhere(driver: Driver, name: str) -> Refused | None:
    """Return the refusal of a service that the robot has only in another mode. Return None if the robot has no
    service of this name in any mode."""
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
            closest_name = next(iter(closest(name, verb.inputs)), None)
            return refusals.unknown_input(verb.name, name, closest_name, takes)
        type_name = verb.inputs[name]["type"]
        if not isinstance(value, _TYPES[type_name]) or (isinstance(value, bool) and type_name != "boolean"):
            return refusals.wrong_type(verb.name, name, value, type_name)
    for name in verb.required:
        if name not in inputs:
            return refusals.missing_input(verb.name, name, takes)
    if verb.does == "move_to" and not any(name in inputs for name in ("targets", *POSE_INPUTS)):
        return refusals.missing_input(verb.name, "targets", takes)
    return None


__all__ = ["Call", "Kind", "is_motion", "read", "tool_spec"]
