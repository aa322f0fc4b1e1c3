"""Read leader arms of Feetech servos: so100_leader, so101_leader."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from strands_actors.drivers.common.kit.robot_tables import RobotTables
from strands_actors.drivers.common.servo.leader import Leader

from .driver import Feetech
from .robots import LEADERS


class FeetechLeader(Leader, Feetech):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(LEADERS.robots)
    ALIASES: ClassVar[Mapping[str, str]] = LEADERS.aliases
    TABLES: ClassVar[RobotTables] = LEADERS
