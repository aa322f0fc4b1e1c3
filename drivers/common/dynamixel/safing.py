"""Making every Dynamixel safe: how long its replies may talk over a safe frame, and what counts as
a hold."""

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
        """A servo that its bus watchdog has stopped holds where it is, and takes no goal."""
        tripped = table.BUS_WATCHDOG.decode(block, base) == table.WATCHDOG_TRIPPED
        if tripped and table.TORQUE_ENABLE.decode(block, base):
            return ""
        return super().holds(block, base, goal)
