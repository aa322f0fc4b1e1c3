"""Load the robots that the Reachy Mini driver supports from ``robots.toml``."""

from __future__ import annotations

from strands_actors.contract.axis import Axis
from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Reachy Mini")


def axes_of(robot: str) -> tuple[Axis, ...]:
    """Return the axes of a robot in their order. Raise ``ValueError`` for an unknown robot."""
    rows = TABLES.table(robot)["axes"].items()
    return tuple(
        Axis(key=key, unit=unit, low=float(low), high=float(high), speed=float(speed), id=number)
        for number, (key, (unit, low, high, speed)) in enumerate(rows, 1)
    )
