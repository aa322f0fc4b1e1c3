"""From what a driver declares to a tool's spec, and from what a model sent to a call or a refusal.
Pure."""

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
"""What is refused when no verb is known."""
MAX_INPUTS = 64
"""No verb takes so many."""

_TYPES: Mapping[str, tuple[type, ...]] = {
    "array": (list, tuple),
    "object": (Mapping,),
    "number": (int, float),
    "boolean": (bool,),
    "string": (str,),
}


@dataclass(frozen=True)
class Call:
    """A declared verb with inputs of the declared types."""

    verb: ToolVerb
    inputs: Mapping[str, Any] = field(default_factory=dict)
    moves: bool = False  # of a service: it comes to motion
    asks: bool = False  # of a service: its driver does not declare it for agents, so a person is asked
    means: Mapping[str, float] | None = None  # of an action: the command, where a driver has translated it

    @property
    def kind(self) -> Kind:
        """Return what it comes to: torque that is taken away is a stop."""
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
        """Return for how many seconds a command is to be sent again; None: once."""
        return self.inputs.get(self.verb.lasts) if self.verb.lasts else None

    @property
    def action(self) -> dict[str, Any]:
        """Return the command of a verb that does ``action``; the targets of ``move_to``."""
        if self.verb.does == "move_to":
            return dict(self.inputs["targets"])
        return self.verb.command(self.inputs) if self.means is None else dict(self.means)


def read(driver: Driver, given: object, tool_name: str = "") -> Call | Refused:
    """Return what a model asks for. A null is an input that is not given; a stop minds no input, and is
    understood in every form."""
    verbs = verbs_of(driver)
    names = ", ".join(verb.name for verb in verbs)
    said = given.get("action") if isinstance(given, Mapping) else None
    wanted = said.strip().lower() if isinstance(said, str) else None
    verb = next((verb for verb in verbs if verb.name == wanted), None)
    if verb is None and asks_for_stop(given, f"{driver.robot} {tool_name}"):
        verb = _stop_of(driver)
    if verb is not None and verb.does == "stop":
        return Call(verb)
    if not isinstance(given, Mapping):
        return Refused(
            Code.BAD_INPUT, f"the input is {shown(given)}", f"give an object with action: {names}", verb=TOOL
        )
    if verb is not None and verb.does == "torque" and as_python(given.get("enabled")) is False:
        return Call(verb, {"enabled": False})  # a stop, too
    if len(given) > MAX_INPUTS:
        return Refused(Code.BAD_INPUT, f"it has {len(given)} inputs", f"give at most {MAX_INPUTS}", verb=TOOL)
    if all(value is None for value in given.values()):  # an empty input asks how the robot is
        verb = next((verb for verb in verbs if verb.name == "status"), None)
    if verb is None:
        if isinstance(wanted, str) and (refused := _refuse_elsewhere(driver, wanted)):
            return refused
        what = "no action is given" if said is None else f"{shown(said)} is not a verb of {driver.robot}"
        return Refused(Code.UNKNOWN_VERB, what, f"use {names}", shown(said), names, verb=TOOL)
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
    """Return why a service that the robot has in another mode is none here; None: it has none of that
    name."""
    refused = driver.check_service(name, {})
    return refused.about(name) if refused is not None and refused.code != Code.UNKNOWN_SERVICE else None


def _stop_of(driver: Driver) -> ToolVerb:
    return min((verb for verb in driver.TOOL_VERBS if verb.does == "stop"), key=lambda verb: verb.name != "stop")


def is_motion(service: Service) -> bool:
    """Return whether others than the robot's own program need leave for it: it moves the robot, or
    gives and takes its motors' power."""
    return service.moves or service.powers or service.acts


def _refuse_inputs(verb: ToolVerb, inputs: Mapping[str, Any]) -> Refused | None:
    takes = ", ".join(verb.inputs) or "no input"
    for name, value in inputs.items():
        if name not in verb.inputs:
            close = closest(name, verb.inputs)
            hint = f" ({close[0]!r}?)" if close else ""
            what = f"it takes no {shown(name)}{hint}"
            return Refused(Code.UNKNOWN_INPUT, what, f"it takes {takes}", shown(name), takes, verb=verb.name)
        kind = verb.inputs[name]["type"]
        if not isinstance(value, _TYPES[kind]) or (isinstance(value, bool) and kind != "boolean"):
            what = f"{name} is {shown(value)}"
            return Refused(Code.BAD_INPUT, what, f"give it as {kind}", shown(value), kind, verb=verb.name)
    for name in verb.required:
        if name not in inputs:
            return Refused(Code.BAD_INPUT, f"{name} is missing", f"it takes {takes}", "", takes, verb=verb.name)
    return None


__all__ = ["Call", "Kind", "is_motion", "read", "tool_spec"]
