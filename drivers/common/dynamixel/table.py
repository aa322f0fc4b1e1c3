"""The control table of X-series servos, and the meaning of its values. Pure data."""

from __future__ import annotations

from typing import NamedTuple


class Register(NamedTuple):
    """One register of the control table: address, size in bytes, and whether it is signed (two's complement)."""

    address: int
    size: int = 1
    signed: bool = False

    def encode(self, value: int) -> bytes:
        """Encode a value, little-endian. Raise ``ValueError`` if it does not fit the register."""
        try:
            return value.to_bytes(self.size, "little", signed=self.signed)
        except OverflowError:
            raise ValueError(f"{value} does not fit {self.size} byte(s)") from None

    def decode(self, data: bytes, base: int | None = None) -> int:
        """Return the value of this register.

        Args:
            data: A block of bytes that contains the register.
            base: The address of the first byte of the block. The default is the address of this register.
        """
        start = 0 if base is None else self.address - base
        return int.from_bytes(data[start : start + self.size], "little", signed=self.signed)


# EEPROM registers. The servo refuses to write them while its torque is on.
MODEL = Register(0, 2)
FIRMWARE = Register(6)
ID = Register(7)
BAUD = Register(8)
RETURN_DELAY = Register(9)  # unit: 2 us; value at delivery: 250
# Bit 0 reverses the direction. The servo itself reverses it, so the host must not reverse it again.
DRIVE_MODE = Register(10)
MODE = Register(11)
SECONDARY_ID = Register(12)
PROTOCOL_TYPE = Register(13)
HOMING_OFFSET = Register(20, 4, True)
MOVING_THRESHOLD = Register(24, 4)  # unit: 0.229 rpm
MAX_TEMPERATURE = Register(31)  # unit: deg C
MAX_VOLTAGE = Register(32, 2)  # unit: 0.1 V
MIN_VOLTAGE = Register(34, 2)
PWM_LIMIT = Register(36, 2)  # full power is 885
CURRENT_LIMIT = Register(38, 2)
VELOCITY_LIMIT = Register(44, 4)
MAX_POSITION = Register(48, 4)
MIN_POSITION = Register(52, 4)
SHUTDOWN = Register(63)  # the hardware errors on which the servo switches its torque off
# RAM
TORQUE_ENABLE = Register(64)
LED = Register(65)
STATUS_LEVEL = Register(68)  # 0: the servo answers a ping only, 1: also a read, 2: every instruction
REGISTERED = Register(69)
HARDWARE_ERROR = Register(70)
VELOCITY_I, VELOCITY_P = Register(76, 2), Register(78, 2)
POSITION_D, POSITION_I, POSITION_P = Register(80, 2), Register(82, 2), Register(84, 2)
FEEDFORWARD_2, FEEDFORWARD_1 = Register(88, 2), Register(90, 2)
BUS_WATCHDOG = Register(98, 1, True)  # unit: 20 ms; 0: off, -1: the watchdog has stopped the servo
GOAL_PWM = Register(100, 2, True)
GOAL_CURRENT = Register(102, 2, True)
GOAL_VELOCITY = Register(104, 4, True)
PROFILE_ACCELERATION = Register(108, 4)
PROFILE_VELOCITY = Register(112, 4)  # 0 means no limit of the speed
GOAL_POSITION = Register(116, 4, True)
# read only
REALTIME_TICK = Register(120, 2)  # the servo's clock in ms; it wraps after 32767
MOVING = Register(122)
MOVING_STATUS = Register(123)
PRESENT_PWM = Register(124, 2, True)
# The unit is 1 mA on an XL330. An XL430 has no current sensor, and reports its load here, in units of 0.1 %.
CURRENT = Register(126, 2, True)
VELOCITY = Register(128, 4, True)  # unit: 0.229 rpm
POSITION = Register(132, 4, True)
VELOCITY_TRAJECTORY = Register(136, 4, True)
POSITION_TRAJECTORY = Register(140, 4, True)
VOLTAGE = Register(144, 2)  # unit: 0.1 V
TEMPERATURE = Register(146)  # unit: deg C


class IndirectBlock(NamedTuple):
    """The addresses of one block of indirect addressing.

    ``size`` words begin at the address ``addresses``, and ``size`` data bytes at the address ``data``. Word number
    n holds the address of the register that data byte number n stands for. At delivery it holds the address of data
    byte n itself, which a host may then use as free RAM.
    """

    addresses: int
    data: int
    size: int


TABLE_SIZE = 148
EEPROM_END = 64
READ_ONLY = frozenset((*range(7), 69, 70, *range(120, TABLE_SIZE)))
GOALS = range(GOAL_PWM.address, GOAL_POSITION.address + GOAL_POSITION.size)
"""Goals, and the profile on the way to them."""

CURRENT_MODE = 0
VELOCITY_MODE = 1
POSITION_MODE = 3
EXTENDED_POSITION_MODE = 4
CURRENT_POSITION_MODE = 5
PWM_MODE = 16
MODE_NAMES = {
    CURRENT_MODE: "current",
    VELOCITY_MODE: "velocity",
    POSITION_MODE: "position",
    EXTENDED_POSITION_MODE: "extended position",
    CURRENT_POSITION_MODE: "current-based position",
    PWM_MODE: "pwm",
}

WATCHDOG_OFF = 0
WATCHDOG_TRIPPED = -1
WATCHDOG_COUNT_S = 0.02

BAUD_RATES = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000)
"""Rate per code of register 8."""

MODEL_NUMBERS = {
    1020: "XM430-W350",
    1060: "XL430-W250",
    1070: "XC430",
    1120: "XM540-W270",
    1190: "XL330-M077",
    1200: "XL330-M288",
    1210: "XC330-T181",
    1220: "XC330-T288",
}

VOLTAGE_BIT, OVERHEAT_BIT, ENCODER_BIT, SHOCK_BIT, OVERLOAD_BIT = 0x01, 0x04, 0x08, 0x10, 0x20
HARDWARE_BITS = {
    VOLTAGE_BIT: "voltage",
    OVERHEAT_BIT: "overheat",
    ENCODER_BIT: "encoder",
    SHOCK_BIT: "electric shock",
    OVERLOAD_BIT: "overload",
}


def error_words(hardware_error: int) -> str:
    """Return the names of the bits that are set in register 70 (hardware error)."""
    names = [word for bit, word in HARDWARE_BITS.items() if hardware_error & bit]
    rest = hardware_error & ~sum(HARDWARE_BITS)
    return ", ".join(names + ([f"unknown 0x{rest:02x}"] if rest else []))
