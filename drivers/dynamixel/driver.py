"""Drive arms of Dynamixel X-series servos over Protocol 2.0: koch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from strands_actors.drivers.common.dynamixel import watchdog
from strands_actors.drivers.common.dynamixel.gates import FAULT_CODES
from strands_actors.drivers.common.dynamixel.table import BAUD_RATES
from strands_actors.drivers.common.kit.refusals import MotorCode
from strands_actors.drivers.common.kit.robot_tables import RobotTables
from strands_actors.drivers.common.servo.driver import ServoDriver

from .robots import TABLES

DEFAULT_BAUD = 1_000_000
"""The rate that lerobot sets the servos up with. They are delivered with 57 600."""


class Dynamixel(ServoDriver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    WIRE: ClassVar[str] = "strands_actors.drivers.common.dynamixel.wire:DynamixelWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.common.dynamixel.wire:DynamixelStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.dynamixel.twin:main"
    USB_IDS: ClassVar[tuple[tuple[int, int], ...]] = ((0x0403, 0x6014), (0x2F5D, 0x2202), (0x1A86, 0x55D3))
    """FT232H of a U2D2, OpenRB-150, CH343 of the common bus adapters [assumed]."""
    TABLES: ClassVar[RobotTables] = TABLES
    BAUD_RATES: ClassVar[tuple[int, ...]] = BAUD_RATES
    DEFAULT_BAUD: ClassVar[int] = DEFAULT_BAUD
    MAX_OFFSET: ClassVar[int] = 1_044_479
    LEROBOT_TYPES: ClassVar[Mapping[str, tuple[str, ...]]] = {"koch": ("koch_follower",)}
    SETUP: ClassVar[str] = "strands_actors.drivers.common.dynamixel.setup:DynamixelSetup"
    HOST_INVERTS: ClassVar[bool] = False  # the servo itself inverts its direction, by its drive mode register
    FAULT_CODES: ClassVar[Mapping[str, MotorCode]] = FAULT_CODES

    firmware_watchdog = (
        f"bus watchdog (register 98) armed at {watchdog.SECONDS:g} s and read back whenever the arm is energised: "
        "a servo that receives nothing for this time stops where it is, torque on, and takes no goal until resume()"
    )
