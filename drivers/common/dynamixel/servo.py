"""A simulated Dynamixel servo: its control table, and the effect of the table on the joint."""

from __future__ import annotations

import math
from typing import NamedTuple

from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.common.twin.servo_bus import COUNTS, COUNTS_PER_RAD, ZERO_COUNT, TwinServo

from . import protocol as p
from . import table as t
from .indirect import Indirect, Region, Run

FIRMWARE_VERSION = 52
ROOM_TEMPERATURE_C = 30
MOVING_RAD_S = 0.01
VELOCITY_UNITS = 60 / math.tau / 0.229
"""Register counts per rad/s."""

PWM_MAX = 885
GAIN_MAX = 16_383
TOP_RAD_S = 6.0
"""Speed without load at full power [assumed]."""

OVERLOAD_LOAD = 0.9
OVERLOAD_S = 1.0
"""An effort of this share of the maximum for this time is an overload [assumed]."""

INVERTED = 0x01
"""Bit of DRIVE_MODE: the count falls when the joint turns in the positive direction."""
TIMED_PROFILE = 0x04
"""Bit of DRIVE_MODE: the profile velocity is the duration of a move, in ms."""

IN_POSITION, PROFILE_ONGOING, FOLLOWING_ERROR, RECTANGULAR_PROFILE = 0x01, 0x02, 0x08, 0x10
"""Bits of MOVING_STATUS."""
IN_POSITION_COUNTS = 20
"""[assumed]"""

CLEAR_TURNS = b"\x01\x44\x58\x4c\x22"
"""The required parameters of CLEAR."""

ALL, ALL_BUT_ID, ALL_BUT_ID_AND_RATE = 0xFF, 0x01, 0x02
"""Options of a factory reset: the registers that it resets."""
FACTORY_BAUD = 57_600


POSITION_MODES = frozenset((t.POSITION_MODE, t.EXTENDED_POSITION_MODE, t.CURRENT_POSITION_MODE))
WITHOUT_CURRENT = frozenset((t.VELOCITY_MODE, t.POSITION_MODE, t.EXTENDED_POSITION_MODE, t.PWM_MODE))


class ModelValues(NamedTuple):
    """Register values at delivery that depend on the servo's model. Source: the vendor's control tables."""

    max_temperature_c: int
    min_voltage: int  # unit: 0.1 V
    max_voltage: int
    velocity_limit: int
    current_limit: int  # mA; 0 for a model without a current sensor, which reports its load instead
    shutdown: int
    stall_current: int  # current at the stall torque, in mA
    velocity_max: int  # highest value that the velocity limit register accepts
    gains: tuple[int, int, int, int]  # gains: velocity I and P, position D and P
    modes: frozenset[int]
    indirect: tuple[t.IndirectBlock, ...]


_LARGE = t.IndirectBlock(168, 224, 28), t.IndirectBlock(578, 634, 28)
_SMALL = (t.IndirectBlock(168, 208, 20),)

XL430 = ModelValues(72, 60, 140, 265, 0, 0x34, 0, 1023, (1000, 100, 4000, 640), WITHOUT_CURRENT, _LARGE)
XL330 = ModelValues(70, 35, 70, 445, 1750, 0x35, 1470, 2047, (1600, 180, 0, 400), frozenset(t.MODE_NAMES), _SMALL)
XM430 = ModelValues(80, 95, 160, 200, 1193, 0x34, 2300, 1023, (1920, 100, 0, 800), frozenset(t.MODE_NAMES), _LARGE)
MODEL_VALUES = {
    "XL430-W250": XL430,
    "XM430-W350": XM430,
    "XL330-M288": XL330,
    "XL330-M077": XL330._replace(velocity_limit=1620),
}
"""Other models count as an XL430 [assumed]."""

RANGES: dict[t.Register, tuple[int, int]] = {
    t.ID: (0, p.MAX_ID),
    t.BAUD: (0, len(t.BAUD_RATES) - 1),
    t.RETURN_DELAY: (0, 254),
    t.DRIVE_MODE: (0, 13),
    t.SECONDARY_ID: (0, 255),
    t.PROTOCOL_TYPE: (2, 2),
    t.MOVING_THRESHOLD: (0, 1023),
    t.HOMING_OFFSET: (-1_044_479, 1_044_479),
    t.MAX_TEMPERATURE: (0, 100),
    t.MAX_VOLTAGE: (31, 160),
    t.MIN_VOLTAGE: (31, 160),
    t.PWM_LIMIT: (0, PWM_MAX),
    t.MAX_POSITION: (0, COUNTS - 1),
    t.MIN_POSITION: (0, COUNTS - 1),
    t.TORQUE_ENABLE: (0, 1),
    t.LED: (0, 1),
    t.STATUS_LEVEL: (0, 2),
    **dict.fromkeys((t.VELOCITY_I, t.VELOCITY_P, t.POSITION_D, t.POSITION_I, t.POSITION_P), (0, GAIN_MAX)),
    **dict.fromkeys((t.FEEDFORWARD_1, t.FEEDFORWARD_2), (0, GAIN_MAX)),
    t.PROFILE_ACCELERATION: (0, 32_767),
    t.PROFILE_VELOCITY: (0, 32_767),
    t.BUS_WATCHDOG: (t.WATCHDOG_OFF, 127),
}
"""The accepted range of a register. Any other value is a data range error."""

GOALS = (t.GOAL_PWM, t.GOAL_CURRENT, t.GOAL_VELOCITY, t.GOAL_POSITION)
"""Read-only while the bus watchdog has tripped."""

LIMITS = {t.GOAL_PWM: t.PWM_LIMIT, t.GOAL_CURRENT: t.CURRENT_LIMIT, t.GOAL_VELOCITY: t.VELOCITY_LIMIT}
"""The register with the limit of each goal, for both directions."""

WORDS = (*RANGES, *GOALS, t.MODE, t.CURRENT_LIMIT, t.VELOCITY_LIMIT)
"""Registers that must be written with all their bytes."""


def factory_table(servo_id: int, model: int, mode: int) -> bytearray:
    """Return a servo's control table with the values at delivery, and zeros elsewhere. Only id, baud rate (1 Mbaud)
    and operating mode are those of an assembled arm."""
    model_values = MODEL_VALUES.get(t.MODEL_NUMBERS.get(model, ""), XL430)
    table = bytearray(t.TABLE_SIZE)
    for register, value in {
        t.MODEL: model,
        t.FIRMWARE: FIRMWARE_VERSION,
        t.ID: servo_id,
        t.BAUD: t.BAUD_RATES.index(1_000_000),
        t.RETURN_DELAY: 250,
        t.MODE: mode,
        t.SECONDARY_ID: 255,
        t.PROTOCOL_TYPE: 2,
        t.MOVING_THRESHOLD: 10,
        t.MAX_TEMPERATURE: model_values.max_temperature_c,
        t.MAX_VOLTAGE: model_values.max_voltage,
        t.MIN_VOLTAGE: model_values.min_voltage,
        t.PWM_LIMIT: PWM_MAX,
        t.CURRENT_LIMIT: model_values.current_limit,
        t.VELOCITY_LIMIT: model_values.velocity_limit,
        t.MAX_POSITION: COUNTS - 1,
        t.SHUTDOWN: model_values.shutdown,
        t.STATUS_LEVEL: 2,
        **dict(zip((t.VELOCITY_I, t.VELOCITY_P, t.POSITION_D, t.POSITION_P), model_values.gains, strict=True)),
    }.items():
        table[register.address : register.address + register.size] = register.encode(value)
    return table


class Servo(TwinServo):
    """A simulated servo with all operating modes of its model. It moves at the profile velocity and ignores the
    profile acceleration."""

    def __init__(self, plant: Plant, joint: int, servo_id: int, model: int, mode: int, voltage_v: float) -> None:
        self.zero_count = float(ZERO_COUNT)
        # Counts per radian of the joint, not of the servo. A gear between them changes the value, also to a
        # negative one.
        self.counts_per_rad = COUNTS_PER_RAD
        super().__init__(plant, joint, factory_table(servo_id, model, mode), voltage_v, ROOM_TEMPERATURE_C)
        self._model_values = MODEL_VALUES.get(t.MODEL_NUMBERS.get(model, ""), XL430)
        self._eeprom = bytearray(self.factory[: t.EEPROM_END])
        self._overload_since_s: float | None = None
        self._last_packet_s = math.inf
        self._waiting = b""
        self._indirect = Indirect(self._model_values.indirect)
        self.power_cycle()

    @property
    def id(self) -> int:
        return self.table[t.ID.address]

    @property
    def bits_per_s(self) -> int | None:
        code = self.table[t.BAUD.address]
        return t.BAUD_RATES[code] if code < len(t.BAUD_RATES) else None

    @property
    def return_delay_s(self) -> float:
        return self.table[t.RETURN_DELAY.address] * 2e-6

    @property
    def energised(self) -> bool:
        return self.table[t.TORQUE_ENABLE.address] != 0

    @property
    def alert(self) -> int:
        return p.ALERT if self.table[t.HARDWARE_ERROR.address] else 0

    def set_identity(self, servo_id: int | None, firmware: str | None) -> None:
        factory = bytearray(self.factory)
        if servo_id is not None:
            factory[t.ID.address] = servo_id
        if firmware is not None:
            factory[t.FIRMWARE.address] = int(firmware)
        self.factory = bytes(factory)
        self._eeprom[:] = self.factory[: t.EEPROM_END]

    def power_cycle(self) -> None:
        """Simulate a power cycle. The EEPROM is kept and the RAM gets its values at delivery. The torque is off,
        and the goal is the joint's position [assumed]."""
        self.table[:] = self.factory
        self.table[: t.EEPROM_END] = self._eeprom
        self._indirect = Indirect(self._model_values.indirect)
        self._begin_mode()
        self._overload_since_s = None
        self._waiting = b""
        self.sense()
        self.put(t.GOAL_POSITION, self.get(t.POSITION))
        self._apply()

    def reset(self, option: int) -> int:
        """Reset the registers to their values at delivery.

        Args:
            option: ``ALL``, ``ALL_BUT_ID`` or ``ALL_BUT_ID_AND_RATE``: the registers that are reset.

        Returns:
            The error number; 0 for success.
        """
        kept = {ALL: (), ALL_BUT_ID: (t.ID,), ALL_BUT_ID_AND_RATE: (t.ID, t.BAUD)}.get(option)
        if kept is None:
            return p.RANGE_ERROR
        values = {t.ID: 1, t.BAUD: t.BAUD_RATES.index(FACTORY_BAUD), t.MODE: t.POSITION_MODE}
        values |= {register: self.get(register) for register in kept}
        self._eeprom[:] = self.factory[: t.EEPROM_END]
        for register, value in values.items():
            self._eeprom[register.address] = value
        self.power_cycle()
        return 0

    def clear_turns(self, params: bytes) -> int:
        """Set the count of whole turns to 0, unless the joint moves. Return the error number, 0 for success."""
        if params != CLEAR_TURNS:
            return p.RANGE_ERROR
        if abs(self.reading.rad_s) > MOVING_RAD_S:
            return p.RESULT_FAIL
        self.zero_count -= COUNTS * math.floor(self._count() / COUNTS)
        self.sense()
        self.put(t.GOAL_POSITION, self.get(t.POSITION))
        self._apply()
        return 0

    def read(self, address: int, size: int) -> tuple[int, bytes]:
        """Read ``size`` bytes from ``address``. Return the error number, 0 for success, and the bytes."""
        if address + size > t.TABLE_SIZE:
            runs = self._indirect.runs(address, size)
            if runs is None:
                return p.ACCESS_ERROR, b""
            self.sense()
            return 0, b"".join(self._indirect.read(run, self.table) for run in runs)
        if address + size > t.REALTIME_TICK.address:
            self.sense()
        return 0, bytes(self.table[address : address + size])

    def write(self, address: int, data: bytes) -> int:
        """Write ``data`` at ``address``. Return the error number, 0 for success. A refused write changes
        nothing."""
        runs = [Run(Region.TABLE, address, len(data))]
        if address + len(data) > t.TABLE_SIZE:
            indirect_runs = self._indirect.runs(address, len(data))
            if indirect_runs is None:
                return p.ACCESS_ERROR
            runs = indirect_runs
        offset = 0
        blocks = []
        for run in runs:
            blocks.append((run, data[offset : offset + run.size]))
            offset += run.size
        for run, block in blocks:
            in_table = run.region is Region.TABLE
            error = (
                self._refuses(range(run.offset, run.offset + run.size), block) if in_table else run.refuses(block)
            )
            if error:
                return error
        for run, block in blocks:
            if run.region is Region.TABLE:
                self._put_bytes(run.offset, block)
            else:
                self._indirect.write(run, block)
        self._apply()
        return 0

    def _put_bytes(self, address: int, block: bytes) -> None:
        self.table[address : address + len(block)] = block
        if address >= t.EEPROM_END:
            return
        if t.MODE.address in range(address, address + len(block)):
            self._begin_mode()
        self._eeprom[:] = self.table[: t.EEPROM_END]

    def _begin_mode(self) -> None:
        """Set the goal registers to their values at delivery: 0 for the goal that the operating mode follows, its
        limit for every other goal [assumed]."""
        mode = self.get(t.MODE)
        driven = {t.PWM_MODE: t.GOAL_PWM, t.CURRENT_MODE: t.GOAL_CURRENT, t.VELOCITY_MODE: t.GOAL_VELOCITY}.get(
            mode
        )
        for goal, limit in LIMITS.items():
            self.put(goal, 0 if goal is driven else self.get(limit))

    def _refuses(self, covers: range, data: bytes) -> int:
        if not covers or covers.stop > t.TABLE_SIZE or not t.READ_ONLY.isdisjoint(covers):
            return p.ACCESS_ERROR
        if covers.start < t.EEPROM_END and self.energised:
            return p.ACCESS_ERROR
        for register in WORDS:
            inside = sum(byte in covers for byte in range(register.address, register.address + register.size))
            if not inside:
                continue
            if inside < register.size:
                return p.LENGTH_ERROR
            error = self._refuses_value(register, register.decode(data, covers.start))
            if error:
                return error
        return 0

    def _refuses_value(self, register: t.Register, value: int) -> int:
        low, high = RANGES.get(register, (value, value))
        if not low <= value <= high:
            return p.RANGE_ERROR
        if self.get(t.BUS_WATCHDOG) == t.WATCHDOG_TRIPPED and (
            register in GOALS or (register is t.BUS_WATCHDOG and value != t.WATCHDOG_OFF)
        ):
            return p.RANGE_ERROR
        if register is t.TORQUE_ENABLE and value and self.alert:
            # A servo with a hardware error refuses torque until it is rebooted.
            return p.ACCESS_ERROR
        if register is t.MODE:
            return 0 if value in self._model_values.modes else p.RANGE_ERROR
        if register is t.VELOCITY_LIMIT or register is t.CURRENT_LIMIT:
            most = (
                self._model_values.velocity_max
                if register is t.VELOCITY_LIMIT
                else self._model_values.current_limit
            )
            return 0 if value <= most else p.RANGE_ERROR
        if register in LIMITS:
            return 0 if abs(value) <= self.get(LIMITS[register]) else p.LIMIT_ERROR
        if register is t.GOAL_POSITION and self.get(t.MODE) == t.POSITION_MODE:
            within = self.get(t.MIN_POSITION) <= value <= self.get(t.MAX_POSITION)
            return 0 if within else p.LIMIT_ERROR
        return 0

    def keep(self, params: bytes) -> None:
        """Store address and data of a REG_WRITE instruction, until ACTION writes them."""
        self._waiting = params
        self.put(t.REGISTERED, 1)

    def act(self) -> int:
        """Carry out ACTION: write the data that REG_WRITE has stored. Return the error number, 0 for success."""
        if not self._waiting:
            return p.INSTRUCTION_ERROR
        params, self._waiting = self._waiting, b""
        self.put(t.REGISTERED, 0)
        return self.write(int.from_bytes(params[:2], "little"), params[2:])

    # -- actions of the firmware without a request

    def hear(self, now_s: float) -> None:
        """Note that an instruction packet for this servo has arrived. Every packet restarts the bus watchdog."""
        self._last_packet_s = now_s
        self.put(t.REALTIME_TICK, int(now_s * 1000) % 32_768)

    @property
    def trips_at_s(self) -> float:
        """The time at which the bus watchdog stops this servo if no packet arrives before. Infinite if the watchdog
        or the torque is off."""
        counts = self.get(t.BUS_WATCHDOG)
        if counts <= t.WATCHDOG_OFF or not self.energised:
            return math.inf
        return self._last_packet_s + counts * t.WATCHDOG_COUNT_S

    def trip(self) -> None:
        """Simulate the bus watchdog: stop at the joint's position, with torque on [assumed: like a hold]."""
        self.put(t.BUS_WATCHDOG, t.WATCHDOG_TRIPPED)
        self.move_target(self.reading.rad)

    def protect(self, now_s: float) -> None:
        """Set the hardware error bits, which stay set until a reboot. Switch the torque off for the errors that the
        register SHUTDOWN names."""
        table = self.table
        errors = table[t.HARDWARE_ERROR.address]
        if not self.get(t.MIN_VOLTAGE) <= round(self.voltage_v * 10) <= self.get(t.MAX_VOLTAGE):
            errors |= t.VOLTAGE_BIT
        if self.temperature_c >= self.get(t.MAX_TEMPERATURE):
            errors |= t.OVERHEAT_BIT
        if abs(self.reading.load) < OVERLOAD_LOAD:
            self._overload_since_s = None
        elif self._overload_since_s is None:
            self._overload_since_s = now_s
        elif now_s - self._overload_since_s >= OVERLOAD_S:
            errors |= t.OVERLOAD_BIT
        table[t.HARDWARE_ERROR.address] = errors
        if errors & table[t.SHUTDOWN.address] and self.energised:
            self.put(t.TORQUE_ENABLE, 0)
            self._apply()

    def sense(self) -> None:
        if self.fault is Fault.STUCK:
            return
        _, rad_s, load = self.reading
        sign = self._sign
        count = self._count()
        if self.get(t.MODE) == t.POSITION_MODE:
            # In position mode the encoder count stays within one turn. In the other modes it includes whole turns.
            count %= COUNTS
        if self.fault is Fault.WRONG:
            count += COUNTS // 2
        amount = max(-1.0, min(1.0, sign * load))
        # A model without a current sensor reports its load, in units of 0.1 % of the stall torque.
        stall = self._model_values.stall_current or 1000
        for register, value in (
            (t.POSITION, count + self.get(t.HOMING_OFFSET)),
            (t.VELOCITY, round(rad_s / self._rad_s_a_unit)),
            (t.PRESENT_PWM, round(amount * PWM_MAX)),
            (t.VELOCITY_TRAJECTORY, round(self.rate_rad_s / abs(self._rad_s_a_unit))),
            (t.POSITION_TRAJECTORY, round(self._count_of(self.target_rad)) + self.get(t.HOMING_OFFSET)),
            (t.MOVING_STATUS, self._moving_status(count)),
            (t.CURRENT, round(amount * stall)),
            (t.VOLTAGE, round(self.voltage_v * 10)),
            (t.TEMPERATURE, round(self.temperature_c)),
            (t.MOVING, int(abs(rad_s) > MOVING_RAD_S)),
        ):
            self.put(register, value)

    @property
    def _sign(self) -> int:
        return -1 if self.table[t.DRIVE_MODE.address] & INVERTED else 1

    @property
    def _rad_s_a_unit(self) -> float:
        """The joint's speed in rad/s for one unit of a velocity register."""
        return self._sign / VELOCITY_UNITS * COUNTS_PER_RAD / self.counts_per_rad

    def _count_of(self, rad: float) -> float:
        return self.zero_count + self._sign * rad * self.counts_per_rad

    def _count(self) -> int:
        """Return the encoder's position in counts, including whole turns."""
        return round(self._count_of(self.reading.rad))

    def _moving_status(self, count: int) -> int:
        off = abs(self.get(t.GOAL_POSITION) - self.get(t.HOMING_OFFSET) - count)
        is_moving = bool(self.rate_rad_s)
        return (
            IN_POSITION * (off <= IN_POSITION_COUNTS)
            | PROFILE_ONGOING * is_moving
            | FOLLOWING_ERROR * (not is_moving and off > IN_POSITION_COUNTS)
            | RECTANGULAR_PROFILE * (self.get(t.PROFILE_VELOCITY) > 0)
        )

    def _apply(self) -> None:
        """Make the simulated joint follow the control table."""
        on = self.energised
        if not on or not self.plant.torque(self.joint):
            self.stand()
        if on and self.get(t.BUS_WATCHDOG) != t.WATCHDOG_TRIPPED:
            self.plant.set_effort_share(self.joint, min(1.0, self._drive(self.get(t.MODE))))
        self.plant.set_torque(self.joint, on)

    def _drive(self, mode: int) -> float:
        """Set the joint's target from the goal registers that the operating mode uses. Return the share of the
        maximum effort that these registers permit."""
        power, stall = self.get(t.GOAL_PWM) / PWM_MAX, self._model_values.stall_current
        current = self.get(t.GOAL_CURRENT) / stall if stall else 1.0
        direction = math.copysign(1.0, self._rad_s_a_unit)
        if mode == t.VELOCITY_MODE:
            self.turn(self.get(t.GOAL_VELOCITY) * self._rad_s_a_unit)
            return abs(power)
        if mode == t.PWM_MODE:
            self.turn(direction * power * TOP_RAD_S)
            return abs(power)
        if mode == t.CURRENT_MODE:
            self.turn(direction * math.copysign(TOP_RAD_S, current) if current else 0.0)
            return abs(current)
        count = self.get(t.GOAL_POSITION) - self.get(t.HOMING_OFFSET)
        rad = self._sign * (count - self.zero_count) / self.counts_per_rad
        self.move_target(rad, self._profile_rad_s(rad))
        return min(abs(power), abs(current)) if mode == t.CURRENT_POSITION_MODE else abs(power)

    def _profile_rad_s(self, goal_rad: float) -> float:
        """Return the speed of the move to a goal in rad/s; 0 means full speed."""
        profile = self.get(t.PROFILE_VELOCITY)
        if not profile or not self.table[t.DRIVE_MODE.address] & TIMED_PROFILE:
            return profile * abs(self._rad_s_a_unit)
        if self.rate_rad_s and goal_rad == self.aimed_rad:
            # The goal has not changed, so the move continues at its present speed.
            return self.rate_rad_s
        return abs(goal_rad - self.reading.rad) / (profile / 1000)
