"""Drive arms and legs of Feetech STS and SMS servos: so100, so101, hope_jr, open_duck_mini."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from strands_actors.drivers.common.kit.refusals import MotorCode
from strands_actors.drivers.common.kit.robot_tables import RobotTables
from strands_actors.drivers.common.servo.driver import ServoDriver

from .gates import FAULT_CODES
from .protocol import BAUD_RATES, HOMING_OFFSET
from .robots import TABLES


class Feetech(ServoDriver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    WIRE: ClassVar[str] = "strands_actors.drivers.feetech.wire:FeetechWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.feetech.wire:FeetechStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.feetech.twin:main"
    USB_IDS: ClassVar[tuple[tuple[int, int], ...]] = ((0x1A86, 0x55D3), (0x1A86, 0x7523))
    """CH343 of the common bus adapters, CH340 of older ones [assumed]."""
    TABLES: ClassVar[RobotTables] = TABLES
    BAUD_RATES: ClassVar[tuple[int, ...]] = BAUD_RATES
    DEFAULT_BAUD: ClassVar[int] = BAUD_RATES[0]
    MAX_OFFSET: ClassVar[int] = (1 << (HOMING_OFFSET.sign_bit or 0)) - 1
    HOST_INVERTS: ClassVar[bool] = True
    LEROBOT_TYPES: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "so100": ("so_follower",),  # since lerobot 0.4 the calibrations of so100 and so101 are in one folder
        "so101": ("so_follower",),
        "hope_jr": ("hope_jr_arm",),
    }
    SETUP: ClassVar[str] = "strands_actors.drivers.feetech.setup:FeetechSetup"
    FAULT_CODES: ClassVar[Mapping[str, MotorCode]] = FAULT_CODES

    firmware_watchdog = "The firmware has no watchdog: a servo holds its last goal with torque on, for ever"
