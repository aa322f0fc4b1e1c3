"""Making every Feetech servo safe: how long its replies may talk over a safe frame."""

from __future__ import annotations

from typing import ClassVar

from strands_actors.drivers.common.servo.axes import TOP
from strands_actors.drivers.common.servo.safing import Safing

from . import protocol


class FeetechSafing(Safing[protocol.Packet]):
    REPEATS: ClassVar[int] = 2
    REPEAT_S: ClassVar[float] = 0.0025
    """By then six replies have finished (6 x 30 bytes), and by the last one fourteen."""

    ANYWHERE: ClassVar[tuple[int, int]] = (0, TOP)
