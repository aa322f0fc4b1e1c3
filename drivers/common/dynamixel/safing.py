"""Make Dynamixel servos safe: how often a stop frame is repeated, so that replies on the bus cannot garble every
copy of it, and when a servo counts as holding."""

from __future__ import annotations

from typing import ClassVar

from strands_actors.drivers.common.servo.safing import Safing

from . import protocol, table
from .identify import ANYWHERE


class DynamixelSafing(Safing[protocol.Packet]):
    REPEATS: ClassVar[int] = 3
    REPEAT_S: ClassVar[float] = 0.004
    """By then six of the longest replies have finished (6 x (94 bytes + 0.5 ms))."""

    ANYWHERE: ClassVar[tuple[int, int]] = ANYWHERE

    def holds(self, block: bytes, base: int, goal: int | None) -> str:
        """Return why a servo does not hold; empty if it does. A servo that its bus watchdog has stopped also counts
        as holding: it keeps its position and refuses goals."""
        tripped = table.BUS_WATCHDOG.decode(block, base) == table.WATCHDOG_TRIPPED
        if tripped and table.TORQUE_ENABLE.decode(block, base):
            return ""
        return super().holds(block, base, goal)
