"""Simulate an arm of Dynamixel servos behind its real serial protocol."""

from __future__ import annotations

import time
from collections.abc import Callable

from strands_actors.drivers.common.dynamixel import twin
from strands_actors.drivers.common.twin import Server, WireLog, main_of
from strands_actors.drivers.common.twin.servo_bus import BusOptions, serve

from .robots import LEADERS, TABLES

MODELLED = (twin.INSTRUCTIONS,)


class DynamixelBus(twin.DynamixelBus):
    @classmethod
    def for_robot(cls, robot: str, now_s: Callable[[], float] = time.monotonic) -> DynamixelBus:
        """Return the simulated servo bus of a robot of ``robots.toml``, or of a leader arm."""
        return cls.of_table((LEADERS if robot in LEADERS.robots else TABLES).table(robot), now_s)


def build(robot: str, options: BusOptions, log: WireLog) -> Server:
    """Return the server of a robot of ``robots.toml``, or of a leader arm."""
    return serve(DynamixelBus.for_robot(robot), options, log)


main = main_of(BusOptions, build)
