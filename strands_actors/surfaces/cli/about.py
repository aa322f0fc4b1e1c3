"""``twin NAME --about``: show what a simulated robot models of its robot's protocol."""

from __future__ import annotations

from strands_actors.contract.loading import load

from .errors import Problem
from .robots import driver_of_twin

TABLES_OF = "strands_actors.drivers.common.twin.modelled:tables_of"


def show_twin(robot: str) -> None:
    """Print the messages that a simulated robot models, their effects, and its answer to all others.

    Args:
        robot: The type of the robot or leader.
    """
    name, driver_class = driver_of_twin(robot)
    tables = load(TABLES_OF)(driver_class.TWIN, name)
    if not tables:
        raise Problem(f"twin: the twin of {name} has no list of what it models, because it has no protocol")
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console()
    for modelled in tables:
        table = Table(box=box.SIMPLE_HEAD, title=f"{name}: {modelled.title}", title_justify="left")
        table.add_column("message", overflow="fold")
        table.add_column("effect", overflow="fold")
        for row in modelled.rows():
            table.add_row(row.message, row.effect)
        table.add_row("every other", modelled.otherwise, style="bold")
        console.print(table, markup=False)
