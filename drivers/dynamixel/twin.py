"""Simulate an arm of Dynamixel servos behind its real serial protocol."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Unpack

from strands_actors.drivers.common.dynamixel import twin
from strands_actors.drivers.common.twin import Start, read_twin_options
from strands_actors.drivers.common.twin.servo_bus import BusOptions, serve

from .robots import LEADERS, TABLES

MODELLED = (twin.INSTRUCTIONS,)


class DynamixelBus(twin.DynamixelBus):
    @classmethod
    def for_robot(cls, robot: str, now_s: Callable[[], float] = time.monotonic) -> DynamixelBus:
        """Return the simulated servo bus of a robot of ``robots.toml``, or of a leader arm."""
        return cls.of_table((LEADERS if robot in LEADERS.robots else TABLES).table(robot), now_s)


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Simulate a robot of ``robots.toml`` until interrupted (see ``common.twin.servo_bus.serve``)."""
    serve(DynamixelBus.for_robot(robot), read_twin_options(robot, BusOptions, options), **start)
