"""Leader arms: a person moves the arm by hand, and its servos are only read. They are never energised."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import msgspec

from strands_actors.drivers.common.kit import calibration

from .driver import ServoDriver


class Leader(ServoDriver):
    """A leader arm, which a person moves by hand. Name this class before the follower's driver:
    ``class FeetechLeader(Leader, Feetech)``."""

    CALIBRATIONS: ClassVar[str] = calibration.LEADERS
    firmware_watchdog = "A leader is never energised, so it needs no watchdog"

    @classmethod
    def is_lowered(cls, robot: str) -> bool:
        return False

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        super().__init__(robot, port, options)
        self.config = msgspec.structs.replace(self.config, passive=True)
