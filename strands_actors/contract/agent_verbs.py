"""List the verbs (commands) that an agent or another computer may request from a robot. Pure.

These are the verbs that the robot's driver declares, and the robot's services (methods such as ``take_off``).

A verb in ``Driver.TOOL_VERBS`` was written for agents, under the rules that the driver's author chose
(``Driver.GUARDED``). A service that was written for scripts may be requested, too. But its author did not decide
whether an agent may use it. So on real hardware it always needs an operator's approval.

A service that stops the robot for a special reason (``Service.stops``) is no verb. For agents there is only the
verb ``stop``, and every wording of a stop leads to it (``stop_words``). An agent must not mistake a service that
cuts a flying drone's motors for that stop.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from strands_actors.kernel.messages import sentence_case

from .driver import Driver, Service
from .tool_verbs import Schema, ToolVerb


def verbs_of(driver: Driver) -> tuple[ToolVerb, ...]:
    """Return the verbs that an agent may request from the robot, first those that the driver declares.

    A declared verb is left out if it needs a service that this robot lacks.
    """
    declared = tuple(verb for verb in driver.TOOL_VERBS if verb.does != "service" or verb.name in driver.SERVICES)
    return (*declared, *(_verb(name, driver.SERVICES[name]) for name in undeclared(driver)))


def undeclared(driver: Driver) -> tuple[str, ...]:
    """Return the names of the services that are not among the driver's verbs. An agent needs approval for them."""
    names = {verb.name for verb in driver.TOOL_VERBS}
    return tuple(name for name, service in driver.SERVICES.items() if name not in names and service.stops is None)


def _verb(name: str, service: Service) -> ToolVerb:
    description = f"{sentence_case(service.about).removesuffix('.')}."
    inputs = {
        argument: _schema(name, argument, default, service.counts)
        for argument, default in service.arguments.items()
    }
    return ToolVerb(name, "service", description, inputs)


def _schema(service: str, argument: str, default: object, counts: Mapping[str, int]) -> Schema:
    """Return the JSON schema of a service's argument, derived from its default.

    The default None stands for an optional number.

    Raises:
        TypeError: JSON has no plain value for the default.
    """
    if default is None:
        return {"type": "number", "description": "may be left out"}
    type_names: dict[type, str] = {bool: "boolean", int: "number", float: "number", str: "string"}
    type_name = type_names.get(type(default))
    if type_name is None:
        raise TypeError(f"{service}: the default of {argument} is {default!r}. Declare a number, a text or a bool")
    schema: dict[str, Any] = {"type": type_name}
    words = [f"a whole number, 1 to {counts[argument]}"] if argument in counts else []
    if default != "" and not (isinstance(default, float) and math.isnan(default)):
        words.append(f"left out: {default}")
    return {**schema, "description": "; ".join(words)} if words else schema
