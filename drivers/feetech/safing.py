"""Make every Feetech servo safe. The frame is sent several times, since the replies of servos may collide with it
on the bus."""

from __future__ import annotations

from typing import ClassVar

from strands_actors.drivers.common.servo.axes import TOP
from strands_actors.drivers.common.servo.safing import Safing

from . import protocol


class FeetechSafing(Safing[protocol.Packet]):
    REPEATS: ClassVar[int] = 2
    REPEAT_S: ClassVar[float] = 0.0025
    """Pause between the repeats, in seconds. Replies of six servos (6 x 30 bytes) end within one pause, and those
    of fourteen servos before the last repeat."""

    ANYWHERE: ClassVar[tuple[int, int]] = (0, TOP)
