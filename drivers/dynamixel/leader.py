"""Read leader arms (which a person moves by hand) of Dynamixel X-series servos over Protocol 2.0: koch_leader."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from strands_actors.drivers.common.kit.robot_tables import RobotTables
from strands_actors.drivers.common.servo.leader import Leader

from .driver import Dynamixel
from .robots import LEADERS


class DynamixelLeader(Leader, Dynamixel):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(LEADERS.robots)
    ALIASES: ClassVar[Mapping[str, str]] = LEADERS.aliases
    TABLES: ClassVar[RobotTables] = LEADERS
