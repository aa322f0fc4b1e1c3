"""One servo of the twin: its control table, and how the table moves the joint."""

from __future__ import annotations

import math
from typing import NamedTuple

from strands_actors.drivers.common.physics import Plant
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.common.twin.servo_bus import COUNTS, COUNTS_PER_RAD, ZERO_COUNT, TwinServo

from . import protocol as p
from . import table as t

FIRMWARE_VERSION = 52
ROOM_TEMPERATURE_C = 30
MOVING_RAD_S = 0.01
VELOCITY_UNITS = 60 / math.tau / 0.229
"""Register counts per rad/s."""

PWM_MAX = 885
OVERLOAD_LOAD = 0.9
OVERLOAD_S = 1.0
"""A push this hard, of what it can, for this long is an overload [assumed]."""

INVERTED = 0x01
"""Bit of DRIVE_MODE: it counts the other way round."""


class Kind(NamedTuple):
    """What differs between models: values at delivery, by the vendor's control tables."""

    max_temperature_c: int
    min_voltage: int  # 0.1 V
    max_voltage: int
    velocity_limit: int
    current_limit: int  # mA; 0: it has no current sensor, and reports its load
    shutdown: int
    stall_current: int  # mA at the stall torque


XL430 = Kind(72, 60, 140, 265, 0, 0x34, 0)
XL330 = Kind(70, 35, 70, 445, 1750, 0x35, 1470)
XM430 = Kind(80, 95, 160, 200, 1193, 0x34, 2300)
KINDS = {
    "XL430-W250": XL430,
    "XM430-W350": XM430,
    "XL330-M288": XL330,
    "XL330-M077": XL330._replace(velocity_limit=1620),
}
"""Others are taken for an XL430 [assumed]."""

RANGES: dict[t.Register, tuple[int, int]] = {
    t.ID: (0, p.MAX_ID),
    t.BAUD: (0, len(t.BAUD_RATES) - 1),
    t.RETURN_DELAY: (0, 254),
    t.MODE: (0, 16),
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
    t.BUS_WATCHDOG: (t.WATCHDOG_OFF, 127),
}
"""What a register takes; anything else is a data range error."""

GOALS = (t.GOAL_PWM, t.GOAL_CURRENT, t.GOAL_VELOCITY, t.GOAL_POSITION)
"""Read-only while the bus watchdog has tripped."""

WORDS = (*RANGES, *GOALS, t.PROFILE_ACCELERATION, t.PROFILE_VELOCITY)
"""Registers that are written whole or not at all."""


def factory_table(servo_id: int, model: int, mode: int) -> bytearray:
    """Values at delivery, the rest zero; the id, the rate of 1 Mbaud and the mode as whoever built
    the arm set them."""
    kind = KINDS.get(t.MODEL_NUMBERS.get(model, ""), XL430)
    table = bytearray(t.TABLE_SIZE)
    for register, value in {
        t.MODEL: model,
        t.FIRMWARE: FIRMWARE_VERSION,
        t.ID: servo_id,
        t.BAUD: t.BAUD_RATES.index(1_000_000),
        t.RETURN_DELAY: 250,
        t.MODE: mode,
        t.MAX_TEMPERATURE: kind.max_temperature_c,
        t.MAX_VOLTAGE: kind.max_voltage,
        t.MIN_VOLTAGE: kind.min_voltage,
        t.PWM_LIMIT: PWM_MAX,
        t.CURRENT_LIMIT: kind.current_limit,
        t.VELOCITY_LIMIT: kind.velocity_limit,
        t.MAX_POSITION: COUNTS - 1,
        t.SHUTDOWN: kind.shutdown,
        t.STATUS_LEVEL: 2,
        t.GOAL_PWM: PWM_MAX,
        t.GOAL_CURRENT: kind.current_limit,
        t.GOAL_VELOCITY: kind.velocity_limit,
    }.items():
        table[register.address : register.address + register.size] = register.encode(value)
    return table


class Servo(TwinServo):
    """The position modes (3, 4, 5); in others it does not move. Profiles are not modelled."""

    def __init__(self, plant: Plant, joint: int, servo_id: int, model: int, mode: int, voltage_v: float) -> None:
        self.zero_count = float(ZERO_COUNT)
        self.counts_per_rad = COUNTS_PER_RAD  # of the joint: negative, or times the ratio of a gear
        super().__init__(plant, joint, factory_table(servo_id, model, mode), voltage_v, ROOM_TEMPERATURE_C)
        self._kind = KINDS.get(t.MODEL_NUMBERS.get(model, ""), XL430)
        self._eeprom = bytearray(self.factory[: t.EEPROM_END])
        self._overload_since_s: float | None = None
        self._heard_s = math.inf
        self._waiting = b""
        self.indirect = bytearray(len(t.INDIRECT_DATA))
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

    def power_cycle(self) -> None:
        """EEPROM as it was written, RAM as at delivery, torque off, the goal where the joint is
        [assumed]."""
        self.table[:] = self.factory
        self.table[: t.EEPROM_END] = self._eeprom
        self.indirect[:] = bytes(len(self.indirect))
        self.put(t.GOAL_PWM, self.get(t.PWM_LIMIT))
        self.put(t.GOAL_CURRENT, self.get(t.CURRENT_LIMIT))
        self._overload_since_s = None
        self._waiting = b""
        self.sense()
        self.put(t.GOAL_POSITION, self.get(t.POSITION))
        self._apply()

    def reset(self) -> None:
        """Everything as at delivery but the id and the rate."""
        kept = {register: self.get(register) for register in (t.ID, t.BAUD)}
        self._eeprom[:] = self.factory[: t.EEPROM_END]
        for register, value in kept.items():
            self._eeprom[register.address] = value
        self.power_cycle()

    def read(self, address: int, size: int) -> tuple[int, bytes]:
        """Error number, data."""
        if address in t.INDIRECT_DATA and address + size <= t.INDIRECT_DATA.stop:
            start = address - t.INDIRECT_DATA.start
            return 0, bytes(self.indirect[start : start + size])
        if address + size > t.TABLE_SIZE:
            return p.ACCESS_ERROR, b""
        if address + size > t.MOVING.address:
            self.sense()
        return 0, bytes(self.table[address : address + size])

    def write(self, address: int, data: bytes) -> int:
        """Error number. What is refused changes nothing."""
        covers = range(address, address + len(data))
        if covers.start in t.INDIRECT_DATA and covers.stop <= t.INDIRECT_DATA.stop:
            start = address - t.INDIRECT_DATA.start
            self.indirect[start : start + len(data)] = data
            return 0
        error = self._refuses(covers, data)
        if error:
            return error
        self.table[covers.start : covers.stop] = data
        if covers.start < t.EEPROM_END:
            self._eeprom[:] = self.table[: t.EEPROM_END]
        self._apply()
        return 0

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
            return p.ACCESS_ERROR  # until a reboot
        if register is t.GOAL_POSITION and self.get(t.MODE) == t.POSITION_MODE:
            within = self.get(t.MIN_POSITION) <= value <= self.get(t.MAX_POSITION)
            return 0 if within else p.LIMIT_ERROR
        return 0

    def keep(self, params: bytes) -> None:
        """REG_WRITE: address and data wait for the word."""
        self._waiting = params
        self.put(t.REGISTERED, 1)

    def act(self) -> int:
        """ACTION: the word."""
        if not self._waiting:
            return p.INSTRUCTION_ERROR
        params, self._waiting = self._waiting, b""
        self.put(t.REGISTERED, 0)
        return self.write(int.from_bytes(params[:2], "little"), params[2:])

    # -- what the firmware does by itself

    def hear(self, now_s: float) -> None:
        """An instruction packet for this servo: it feeds the bus watchdog, whatever it says."""
        self._heard_s = now_s

    @property
    def trips_at_s(self) -> float:
        """When the bus watchdog will trip if nothing is heard; never, when it is off or the torque
        is."""
        counts = self.get(t.BUS_WATCHDOG)
        if counts <= t.WATCHDOG_OFF or not self.energised:
            return math.inf
        return self._heard_s + counts * t.WATCHDOG_COUNT_S

    def trip(self) -> None:
        """Stop where the joint is, with torque on [assumed: as a hold]."""
        self.put(t.BUS_WATCHDOG, t.WATCHDOG_TRIPPED)
        self.plant.set_target(self.joint, self.reading.rad)

    def protect(self, now_s: float) -> None:
        """Note hardware errors, which stay until a reboot; let go for those that SHUTDOWN names."""
        table = self.table
        found = table[t.HARDWARE_ERROR.address]
        if not self.get(t.MIN_VOLTAGE) <= round(self.voltage_v * 10) <= self.get(t.MAX_VOLTAGE):
            found |= t.VOLTAGE_BIT
        if self.temperature_c >= self.get(t.MAX_TEMPERATURE):
            found |= t.OVERHEAT_BIT
        if abs(self.reading.load) < OVERLOAD_LOAD:
            self._overload_since_s = None
        elif self._overload_since_s is None:
            self._overload_since_s = now_s
        elif now_s - self._overload_since_s >= OVERLOAD_S:
            found |= t.OVERLOAD_BIT
        table[t.HARDWARE_ERROR.address] = found
        if found & table[t.SHUTDOWN.address] and self.energised:
            self.put(t.TORQUE_ENABLE, 0)
            self._apply()

    def sense(self) -> None:
        if self.fault is Fault.STUCK:
            return
        rad, rad_s, load = self.reading
        sign = -1 if self.table[t.DRIVE_MODE.address] & INVERTED else 1
        count = round(self.zero_count + sign * rad * self.counts_per_rad)
        if self.get(t.MODE) == t.POSITION_MODE:
            count %= COUNTS  # the other modes count turns
        if self.fault is Fault.WRONG:
            count += COUNTS // 2
        amount = max(-1.0, min(1.0, sign * load))
        stall = self._kind.stall_current or 1000  # without a current sensor: 0.1 % of its torque
        for register, value in (
            (t.POSITION, count + self.get(t.HOMING_OFFSET)),
            (t.VELOCITY, round(sign * rad_s * VELOCITY_UNITS * self.counts_per_rad / COUNTS_PER_RAD)),
            (t.CURRENT, round(amount * stall)),
            (t.VOLTAGE, round(self.voltage_v * 10)),
            (t.TEMPERATURE, round(self.temperature_c)),
            (t.MOVING, int(abs(rad_s) > MOVING_RAD_S)),
        ):
            self.put(register, value)

    def _apply(self) -> None:
        """Make the joint do what the table says."""
        mode = self.get(t.MODE)
        on = self.energised and mode in (t.POSITION_MODE, t.EXTENDED_POSITION_MODE, t.CURRENT_POSITION_MODE)
        if on and self.get(t.BUS_WATCHDOG) != t.WATCHDOG_TRIPPED:
            sign = -1 if self.table[t.DRIVE_MODE.address] & INVERTED else 1
            count = self.get(t.GOAL_POSITION) - self.get(t.HOMING_OFFSET)
            self.plant.set_target(self.joint, sign * (count - self.zero_count) / self.counts_per_rad)
            share = abs(self.get(t.GOAL_PWM)) / PWM_MAX
            if mode == t.CURRENT_POSITION_MODE and self._kind.stall_current:
                share = min(share, abs(self.get(t.GOAL_CURRENT)) / self._kind.stall_current)
            self.plant.set_effort_share(self.joint, min(1.0, share))
        self.plant.set_torque(self.joint, on)
