"""What the faults of a Dynamixel mean to who is refused because of one."""

from __future__ import annotations

from .table import HARDWARE_BITS
from .watchdog import TRIPPED, UNARMED

UNNAMED = "hardware alert"
"""The alert bit was seen, and which alert it is not yet read."""

FAULT_CODES = {
    **dict.fromkeys((*HARDWARE_BITS.values(), UNNAMED), "alert"),
    TRIPPED: "watchdog",
    UNARMED: "watchdog_off",
    "limp": "limp",
}
REMEDIES = {
    "alert": "clear the cause, reboot the servo with the arm supported, then stop and resume",
    "watchdog": "stop and resume to clear it",
    "watchdog_off": "end the program that has switched it off, then stop and resume",
    "limp": "take the load off, then stop and resume to energise it again",
}
