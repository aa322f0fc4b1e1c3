"""What the faults of a Dynamixel mean to who is refused because of one."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.drivers.common.refusals import MotorCode

from .table import HARDWARE_BITS
from .watchdog import TRIPPED, UNARMED

UNNAMED = "hardware alert"
"""The alert bit was seen, and which alert it is not yet read."""

FAULT_CODES: Mapping[str, str] = {
    **dict.fromkeys((*HARDWARE_BITS.values(), UNNAMED), MotorCode.ALERT),
    TRIPPED: MotorCode.WATCHDOG,
    UNARMED: MotorCode.WATCHDOG_OFF,
    "limp": MotorCode.LIMP,
}
REMEDIES: Mapping[str, str] = {
    MotorCode.ALERT: "clear the cause, reboot the servo with the arm supported, then stop and resume",
    MotorCode.WATCHDOG: "stop and resume to clear it",
    MotorCode.WATCHDOG_OFF: "end the program that has switched it off, then stop and resume",
    MotorCode.LIMP: "take the load off, then stop and resume to energise it again",
}
