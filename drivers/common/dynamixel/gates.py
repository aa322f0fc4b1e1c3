"""The refusal code of each fault that a Dynamixel servo can report."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.drivers.common.kit.refusals import MotorCode

from .table import HARDWARE_BITS
from .watchdog import TRIPPED, UNARMED

UNNAMED = "hardware alert"
"""The alert bit is set, but the register with the kind of alert was not read yet."""

FAULT_CODES: Mapping[str, MotorCode] = {
    **dict.fromkeys((*HARDWARE_BITS.values(), UNNAMED), MotorCode.ALERT),
    TRIPPED: MotorCode.WATCHDOG,
    UNARMED: MotorCode.WATCHDOG_OFF,
    "limp": MotorCode.LIMP,
}
