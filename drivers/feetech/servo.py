"""Simulate one servo: its control table, and how the table moves the joint."""

from __future__ import annotations

import struct

from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.common.twin.servo_bus import COUNTS_PER_RAD, ZERO_COUNT, TwinServo

from . import protocol as p

STALL_CURRENT = 370
"""Current at full load, in the register's unit of 6.5 mA: 2.4 A [assumed]."""

FIRMWARE_VERSION = 0x0A03  # 3.10
ROOM_TEMPERATURE_C = 30
MOVING_RAD_S = 0.01
MULTI_TURN_FEEDBACK = 0x10
"""Bit of PHASE. With it positions are reported beyond one turn instead of wrapped."""
SENSOR_REGISTERS = slice(p.POSITION.address, p.CURRENT.address + p.CURRENT.size)
"""The registers that the servo's own sensors write."""

SENSOR_LAYOUT = struct.Struct("<HHHBBxBBxxH")
"""Position, velocity, load, voltage, temperature, status, moving, current. They are packed at once: otherwise
every reading of six servos would cost fifty register writes."""

ERROR_VOLTAGE, ERROR_OVERHEAT, ERROR_OVERCURRENT, ERROR_OVERLOAD = 1, 4, 8, 32

TOP_RAD_S = 5.8
"""Speed without load, at full power [assumed]."""


def factory_table(servo_id: int, model: int, voltage_v: float) -> bytearray:
    """Return the control table of an STS3215 at delivery, as in the vendor's documents. Registers that are not
    documented are zero."""
    table = bytearray(p.TABLE_SIZE)
    decivolts = round(voltage_v * 10)
    for register, value in {
        p.FIRMWARE: FIRMWARE_VERSION,
        p.MODEL: model,
        p.ID: servo_id,
        p.BAUD: 0,
        p.RETURN_DELAY: 250,
        p.STATUS_LEVEL: 1,
        p.MIN_POSITION: 0,
        p.MAX_POSITION: p.COUNTS - 1,
        p.MAX_TEMPERATURE: 70,
        # The voltage limit of a 12 V servo is assumed.
        p.MAX_VOLTAGE: 80 if decivolts <= 80 else decivolts + 20,
        p.MIN_VOLTAGE: 40,
        p.MAX_TORQUE: 1000,
        p.PHASE: 12,
        p.UNLOAD_CONDITION: ERROR_OVERHEAT | ERROR_OVERCURRENT | ERROR_OVERLOAD,
        p.LED_ALARM: 47,
        p.P_GAIN: 32,
        p.D_GAIN: 32,
        p.MIN_START_FORCE: 16,
        p.CLOCKWISE_DEAD_ZONE: 1,
        p.COUNTER_DEAD_ZONE: 1,
        p.PROTECTION_CURRENT: 500,
        p.ANGULAR_RESOLUTION: 1,
        p.PROTECTIVE_TORQUE: 20,
        p.PROTECTION_TIME: 200,  # in units of 10 ms
        p.OVERLOAD_TORQUE: 80,  # percent
        p.VELOCITY_P: 10,
        p.OVERCURRENT_TIME: 200,
        p.VELOCITY_I: 10,
    }.items():
        table[register.address : register.address + register.size] = register.encode(value)
    return table


def _sign_magnitude(register: p.Register, value: int) -> int:
    sign = 1 << (register.sign_bit or 0)
    return min(-value, sign - 1) | sign if value < 0 else min(value, sign - 1)


class Servo(TwinServo):
    """Simulate one servo in any of its four modes, without acceleration limits and dead zones.

    ``goal_energises``: True if writing a goal switches the torque on. Several public drivers report this of the
    STS3215. The vendor's SDK has no call for torque, and still moves the servo [assumed: register 40 then reads 1].
    """

    def __init__(
        self, plant: Plant, joint: int, servo_id: int, model: int, voltage_v: float, goal_energises: bool = True
    ) -> None:
        self._goal_energises = goal_energises
        super().__init__(plant, joint, factory_table(servo_id, model, voltage_v), voltage_v, ROOM_TEMPERATURE_C)
        self._eeprom = bytearray(self.factory[: p.EEPROM_END])
        self._since_s: dict[int, float] = {}  # for each error bit, the time at which its condition began
        self._tripped = 0  # error bits for which the servo has switched its torque off
        self._waiting = b""
        self.power_cycle()

    @property
    def id(self) -> int:
        return self.table[p.ID.address]

    @property
    def bits_per_s(self) -> int | None:
        code = self.table[p.BAUD.address]
        return p.BAUD_RATES[code] if code < len(p.BAUD_RATES) else None

    @property
    def return_delay_s(self) -> float:
        return self.table[p.RETURN_DELAY.address] * 2e-6

    @property
    def error(self) -> int:
        table = self.table
        decivolts = round(self.voltage_v * 10)
        volts = table[p.MIN_VOLTAGE.address] <= decivolts <= table[p.MAX_VOLTAGE.address]
        hot = self.temperature_c >= table[p.MAX_TEMPERATURE.address]
        return (0 if volts else ERROR_VOLTAGE) | (ERROR_OVERHEAT if hot else 0) | self._tripped

    def set_identity(self, servo_id: int | None, firmware: str | None) -> None:
        factory = bytearray(self.factory)
        if servo_id is not None:
            factory[p.ID.address] = servo_id
        if firmware is not None:
            factory[: p.FIRMWARE.size] = bytes(int(part) for part in firmware.split(".", 1))
        self.factory = bytes(factory)
        self._eeprom[:] = self.factory[: p.EEPROM_END]

    @property
    def _speed_unit(self) -> int:
        """Counts/s of one unit in the registers of speeds."""
        return p.speed_unit(self.table[p.PHASE.address])

    def power_cycle(self) -> None:
        """Restart the servo. The EEPROM has its saved values, the RAM has its values at delivery, the torque is
        off, and the goal is the present position [assumed]."""
        sensed = self.table[SENSOR_REGISTERS]
        self.table[:] = self.factory
        self.table[: p.EEPROM_END] = self._eeprom
        self.table[SENSOR_REGISTERS] = sensed
        self.put(p.LOCK, 1)
        self.put(p.TORQUE_LIMIT, min(1000, self.get(p.MAX_TORQUE)))
        self._tripped = 0
        self._waiting = b""
        self.sense()
        self.put(p.GOAL_POSITION, self.get(p.POSITION))
        self._apply_torque()

    def reset(self) -> None:
        """Restore all values at delivery, except the id."""
        servo_id = self.id
        self._eeprom[:] = self.factory[: p.EEPROM_END]
        self._eeprom[p.ID.address] = servo_id
        self.power_cycle()

    def read(self, address: int, size: int) -> bytes:
        """Return registers. Bytes beyond the end of the table are zero."""
        if address + size > SENSOR_REGISTERS.start:
            self.sense()
        return bytes(self.table[address : address + size]).ljust(size, b"\0")

    def write(self, address: int, data: bytes) -> None:
        """Write registers. Bytes that are read-only, or beyond the end, are ignored."""
        unlocked = self.table[p.LOCK.address] == 0
        for index, byte in enumerate(data, address):
            if index < p.TABLE_SIZE and index not in p.READ_ONLY:
                self.table[index] = byte
        covers = range(address, address + len(data))
        if p.TORQUE_ENABLE.address in covers:
            self._tripped = 0
            self._since_s.clear()
            if self.table[p.TORQUE_ENABLE.address] == p.SET_MIDDLE:
                self.put(p.HOMING_OFFSET, max(-2047, min(2047, round(self.reading.rad * COUNTS_PER_RAD))))
                self.put(p.TORQUE_ENABLE, 0)
                covers = range(p.HOMING_OFFSET.address, covers.stop)
        elif p.GOAL_POSITION.address in covers and self._goal_energises:
            self.table[p.TORQUE_ENABLE.address] = self.table[p.TORQUE_ENABLE.address] or 1
        if unlocked:
            kept = slice(covers.start, min(covers.stop, p.EEPROM_END))
            self._eeprom[kept] = self.table[kept]
        if covers.start < p.TORQUE_LIMIT.address + 2 and covers.stop > p.TORQUE_ENABLE.address:
            self._apply_torque(stepped=p.GOAL_POSITION.address in covers)
        elif p.MODE.address in covers:
            self._apply_torque()

    def keep(self, params: bytes) -> None:
        """Store a REG_WRITE (address and data) until ``act``."""
        self._waiting = params

    def act(self) -> None:
        """Carry out an ACTION: write the data that ``keep`` has stored."""
        if self._waiting:
            self.write(self._waiting[0], self._waiting[1:])
        self._waiting = b""

    def protect(self, now_s: float) -> None:
        """Switch the torque off for each of these conditions that is enabled in UNLOAD_CONDITION: a load above
        OVERLOAD_TORQUE for PROTECTION_TIME, a current above PROTECTION_CURRENT for OVERCURRENT_TIME, or
        overheating."""
        table, load = self.table, abs(self.reading.load)
        conditions = (
            (ERROR_OVERLOAD, load * 100 > table[p.OVERLOAD_TORQUE.address], table[p.PROTECTION_TIME.address]),
            (
                ERROR_OVERCURRENT,
                load * STALL_CURRENT > self.get(p.PROTECTION_CURRENT),
                table[p.OVERCURRENT_TIME.address],
            ),
            (ERROR_OVERHEAT, self.temperature_c >= table[p.MAX_TEMPERATURE.address], 0),
        )
        for bit, is_so, centiseconds in conditions:
            if not is_so or not table[p.UNLOAD_CONDITION.address] & bit:
                self._since_s.pop(bit, None)
            elif now_s - self._since_s.setdefault(bit, now_s) >= centiseconds * 0.01:
                # Overheating is not stored, since ``error`` reports it for as long as the servo is hot.
                self._tripped |= bit & ~ERROR_OVERHEAT
                self.put(p.TORQUE_ENABLE, 0)
                self._apply_torque()

    def sense(self) -> None:
        if self.fault is Fault.STUCK:
            return
        reading = self.reading
        count = round(ZERO_COUNT + reading.rad * COUNTS_PER_RAD) - self.get(p.HOMING_OFFSET)
        if self.fault is Fault.WRONG:
            count += p.COUNTS // 2
        if not self.table[p.PHASE.address] & MULTI_TURN_FEEDBACK:
            count %= p.COUNTS
        load = round(max(-1.0, min(1.0, reading.load)) * 1000)
        self.table[SENSOR_REGISTERS] = SENSOR_LAYOUT.pack(
            _sign_magnitude(p.POSITION, count),
            _sign_magnitude(p.VELOCITY, round(reading.rad_s * COUNTS_PER_RAD / self._speed_unit)),
            _sign_magnitude(p.LOAD, load),
            round(self.voltage_v * 10),
            round(self.temperature_c),
            self.error,
            abs(reading.rad_s) > MOVING_RAD_S,
            abs(load) * STALL_CURRENT // 1000,
        )

    def _apply_torque(self, stepped: bool = False) -> None:
        """Set the torque, the goal and the speed of the joint from the control table. ``stepped`` is True if a goal
        was just written. In step mode this moves the joint by one more step."""
        on = self.table[p.TORQUE_ENABLE.address] != 0
        if not on or not self.plant.torque(self.joint):
            self.stand()
        self.plant.set_torque(self.joint, on)
        if not on:
            return
        share = min(1000, self.get(p.TORQUE_LIMIT)) / 1000
        rate = self.get(p.GOAL_VELOCITY) * self._speed_unit / COUNTS_PER_RAD
        match self.table[p.MODE.address]:
            case p.VELOCITY_MODE:
                self.turn(rate)
            case p.PWM_MODE:
                power = max(-1.0, min(1.0, self.get(p.GOAL_TIME) / 1000))
                share = min(share, abs(power))
                self.turn(power * TOP_RAD_S)
            case p.STEP_MODE:
                if stepped:
                    self.move_target(self.aimed_rad + self.get(p.GOAL_POSITION) / COUNTS_PER_RAD, abs(rate))
            case _:
                self.move_target((self._goal() - ZERO_COUNT) / COUNTS_PER_RAD, abs(rate))
        self.plant.set_effort_share(self.joint, share)

    def _goal(self) -> int:
        """Return the goal in raw counts of the encoder: the goal register plus the homing offset."""
        low, high, goal = self.get(p.MIN_POSITION), self.get(p.MAX_POSITION), self.get(p.GOAL_POSITION)
        if low < high:  # if both are zero, the goal has no limits
            goal = max(low, min(high, goal))
        return goal + self.get(p.HOMING_OFFSET)
