"""Turn the verbs that a driver declares for agents into methods of a robot's handle.

So scripts and agents use the same verbs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.contract.driver import Driver
from strands_actors.contract.tool_verbs import ToolVerb
from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.agents.calls import Call, read

from . import refusals


def find_verb(driver: Driver | None, name: str) -> ToolVerb | None:
    """Return the verb of this name; None if the driver has no such verb, or if the verb is a service.

    The handle already has each service as a method.
    """
    if driver is None:
        return None
    return next((verb for verb in driver.TOOL_VERBS if verb.name == name and verb.does != "service"), None)


def is_command(driver: Driver, name: str) -> bool:
    """Return True if a verb is a command. A command connects the robot, as ``send_action`` does."""
    verb = find_verb(driver, name)
    return verb is not None and verb.does == "action"


def verb_names(driver: Driver) -> list[str]:
    """Return the names of all verbs that are not services."""
    return [verb.name for verb in driver.TOOL_VERBS if verb.does != "service"]


def call_of(driver: Driver, command: str, values: Sequence[Any], inputs: Mapping[str, Any]) -> Call | Refused:
    """Turn a verb that a script calls into a ``Call``, or return a refusal.

    Args:
        driver: The robot's driver.
        command: Name of the verb.
        values: Inputs by position.
        inputs: Inputs by name. ``_`` stands for a dot: ``linear_x`` for ``linear.x``.
    """
    verb = find_verb(driver, command)
    if verb is None:
        names_of_verbs = ", ".join(verb_names(driver)) or "none"
        return refusals.unknown_command(command, driver.robot, names_of_verbs)
    names = {name.replace(".", "_"): name for name in verb.inputs}
    takes = ", ".join(names) or "no input"
    if len(values) > len(names):
        return refusals.too_many_values(verb.name, len(values), len(names), takes)
    placed = dict(zip(names.values(), values, strict=False))
    named = {names.get(name, name): value for name, value in inputs.items()}
    if twice := sorted(placed.keys() & named.keys()):
        return refusals.given_twice(verb.name, twice[0], takes)
    return read(driver, {"action": verb.name, **placed, **named})
