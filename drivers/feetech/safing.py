"""Make every Feetech servo safe, with repeats of the safe frame in case replies collide with it."""

from __future__ import annotations

from typing import ClassVar

from strands_actors.drivers.common.servo.axes import TOP
from strands_actors.drivers.common.servo.safing import Safing

from . import protocol


class FeetechSafing(Safing[protocol.Packet]):
    REPEATS: ClassVar[int] = 2
    REPEAT_S: ClassVar[float] = 0.0025
    """In this time six replies end (6 x 30 bytes); by the last repeat it is fourteen."""

    ANYWHERE: ClassVar[tuple[int, int]] = (0, TOP)
