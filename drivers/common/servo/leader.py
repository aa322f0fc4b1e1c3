"""Leader arms: the servos of a follower, moved by hand and read. They are never energised."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import msgspec

from strands_actors.drivers.common.kit import calibration

from .driver import ServoDriver


class Leader(ServoDriver):
    """A leader arm. It comes before the follower's class among the bases: ``class
    FeetechLeader(Leader, Feetech)``."""

    CALIBRATIONS: ClassVar[str] = calibration.LEADERS
    firmware_watchdog = "none is needed: a leader is never energised"

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        super().__init__(robot, port, options)
        self.config = msgspec.structs.replace(self.config, passive=True)
