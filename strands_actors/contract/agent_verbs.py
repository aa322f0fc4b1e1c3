"""All that others than the robot's own program may ask of it: the verbs that its driver declares, and
the services that it declares beside them. Pure.

A verb that the driver's author wrote for agents is under the rules that the author chose
(``Driver.GUARDED``). A service that was written for scripts is askable, too, but nobody has judged
whether an agent should decide on it. It always needs an operator's approval on real hardware.

A service that stops the robot for a reason of its own (``Service.stops``) is no verb: an agent has one
stop, in every form of the word, and it must not be taken for one that cuts a flying drone's motors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from .driver import Driver, Service
from .tool_verbs import Schema, ToolVerb


def verbs_of(driver: Driver) -> tuple[ToolVerb, ...]:
    """Return what may be asked: declared verbs first, without those whose service this robot lacks."""
    declared = tuple(verb for verb in driver.TOOL_VERBS if verb.does != "service" or verb.name in driver.SERVICES)
    return (*declared, *(_verb(name, driver.SERVICES[name]) for name in undeclared(driver)))


def undeclared(driver: Driver) -> tuple[str, ...]:
    """Return the names of services that an agent may ask for, but only with approval."""
    names = {verb.name for verb in driver.TOOL_VERBS}
    return tuple(name for name, service in driver.SERVICES.items() if name not in names and service.stops is None)


def _verb(name: str, service: Service) -> ToolVerb:
    says = f"{service.about[0].upper()}{service.about[1:].removesuffix('.')}."
    inputs = {
        argument: _schema(name, argument, default, service.counts)
        for argument, default in service.arguments.items()
    }
    return ToolVerb(name, "service", says, inputs)


def _schema(service: str, argument: str, default: object, counts: Mapping[str, int]) -> Schema:
    """Return the schema of an argument, from its default; None is that of a number that may be left out.
    Raise ``TypeError`` for one that JSON has no plain value for."""
    if default is None:
        return {"type": "number", "description": "may be left out"}
    kinds: dict[type, str] = {bool: "boolean", int: "number", float: "number", str: "string"}
    kind = kinds.get(type(default))
    if kind is None:
        raise TypeError(f"{service}: the default of {argument} is {default!r}. give a number, a text or a bool")
    schema: dict[str, Any] = {"type": kind}
    words = [f"a whole number, 1 to {counts[argument]}"] if argument in counts else []
    if default != "" and not (isinstance(default, float) and math.isnan(default)):
        words.append(f"left out: {default}")
    return {**schema, "description": "; ".join(words)} if words else schema
