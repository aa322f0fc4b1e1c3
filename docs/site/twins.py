"""Write the section of a robot's page about what its twin models."""

from __future__ import annotations

from collections.abc import Iterator

from strands_actors.drivers.common.twin.modelled import tables_of

from . import facts
from .sections import table


def twin_section(robot: str) -> Iterator[str]:
    """Yield the lines of the section. A robot without a protocol has none."""
    tables = tables_of(facts.driver_class(robot).TWIN, robot)
    if not tables:
        return
    yield from (
        "## What its twin models",
        "",
        "The twin answers every other message as the robot answers one that it does not support. "
        f"`strands-actors twin {robot} --about` prints the same tables.",
        "",
    )
    for modelled in tables:
        rows = [(row.message, row.effect) for row in modelled.rows()]
        yield from table((modelled.title, "effect"), [*rows, ("*every other*", modelled.otherwise)])
        yield ""
