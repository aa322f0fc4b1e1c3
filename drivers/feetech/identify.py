"""Read the registers that identify a Feetech servo, check them, and set up the servo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.calibration import MotorCalibration
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus
from strands_actors.drivers.common.servo.axes import TOP, Axis
from strands_actors.drivers.common.servo.handshake import block, check_calibration, check_model, command
from strands_actors.drivers.common.servo.identity import facts_of

from . import protocol

POSITION_MODE = 0

Bus = HalfDuplexBus[protocol.Packet]

_RAM = protocol.TORQUE_ENABLE.address
_RAM_SIZE = protocol.TABLE_SIZE - _RAM - 20  # read registers 40 to 69


class Identity(msgspec.Struct, frozen=True):
    """The registers that identify a servo, and those that decide how it moves."""

    model: int
    firmware: str
    id: int
    return_delay: int
    low: int  # lowest goal that the servo accepts, in counts
    high: int
    homing_offset: int
    mode: int
    speed_unit: int  # counts/s of one unit in the registers of speeds
    max_torque: int  # what TORQUE_LIMIT is after the power was switched on
    torque_limit: int
    max_temperature_c: float
    min_voltage_v: float
    max_voltage_v: float
    torque: bool
    speed_limit: int  # highest speed on the way to a goal, in counts/s; 0 for no limit
    locked: bool
    voltage_v: float
    temperature_c: float

    @property
    def model_name(self) -> str:
        return protocol.MODEL_NUMBERS.get(self.model, f"model {self.model}")

    @property
    def travel(self) -> tuple[int, int]:
        """Return the lowest and the highest goal position that the servo accepts, in counts. If both registers are
        0, the servo turns several times. This driver then uses one turn."""
        return (self.low, self.high) if self.high > self.low else (0, TOP)


async def identify(bus: Bus, axis: Axis) -> Identity:
    """Read one servo's registers. Raise ``WireDown`` if it does not answer."""
    eeprom = await block(bus, protocol, axis, 0, protocol.EEPROM_END)
    ram = await block(bus, protocol, axis, _RAM, _RAM_SIZE)

    def tenths(register: protocol.Register, block: bytes, base: int) -> float:
        return register.decode(block, base) / 10

    return Identity(
        model=protocol.MODEL.decode(eeprom, 0),
        firmware=f"{eeprom[0]}.{eeprom[1]}",
        id=protocol.ID.decode(eeprom, 0),
        return_delay=protocol.RETURN_DELAY.decode(eeprom, 0),
        low=protocol.MIN_POSITION.decode(eeprom, 0),
        high=protocol.MAX_POSITION.decode(eeprom, 0),
        homing_offset=protocol.HOMING_OFFSET.decode(eeprom, 0),
        mode=protocol.MODE.decode(eeprom, 0),
        speed_unit=protocol.speed_unit(protocol.PHASE.decode(eeprom, 0)),
        max_torque=protocol.MAX_TORQUE.decode(eeprom, 0),
        torque_limit=protocol.TORQUE_LIMIT.decode(ram, _RAM),
        max_temperature_c=float(protocol.MAX_TEMPERATURE.decode(eeprom, 0)),
        min_voltage_v=tenths(protocol.MIN_VOLTAGE, eeprom, 0),
        max_voltage_v=tenths(protocol.MAX_VOLTAGE, eeprom, 0),
        torque=bool(protocol.TORQUE_ENABLE.decode(ram, _RAM)),
        speed_limit=protocol.GOAL_VELOCITY.decode(ram, _RAM),
        locked=bool(protocol.LOCK.decode(ram, _RAM)),
        voltage_v=tenths(protocol.VOLTAGE, ram, _RAM),
        temperature_c=float(protocol.TEMPERATURE.decode(ram, _RAM)),
    )


def check(axis: Axis, servo: Identity, motor: MotorCalibration | None) -> None:
    """Check that a servo matches the robot's table and its calibration.

    Raises:
        WireDown: The servo does not match.
    """
    check_model(axis, servo.id, servo.model, protocol)
    if servo.mode != POSITION_MODE:
        raise WireDown(f"{axis.label} is in mode {servo.mode}, not in mode 0 (position). Set register 33 to 0")
    if motor is not None:
        values = {"homing_offset": servo.homing_offset, "range_min": servo.low, "range_max": servo.high}
        check_calibration(axis, motor, values)


async def answer_at_once(bus: Bus, axis: Axis, servo: Identity) -> None:
    """Set the return delay to 0 while the EEPROM is locked. The value is lost when the power is switched off, and
    the EEPROM does not wear. Raise ``WireDown`` if the servo does not answer."""
    if not servo.locked:
        await _set(bus, axis, protocol.LOCK, 1)
    if servo.return_delay:
        await _set(bus, axis, protocol.RETURN_DELAY, 0)


async def lift_speed_limit(bus: Bus, axis: Axis) -> None:
    """Clear the speed limit (register 46) that another program has left, since it would slow down every setpoint.
    Raise ``WireDown`` if the servo does not answer."""
    await _set(bus, axis, protocol.GOAL_VELOCITY, 0)


async def _set(bus: Bus, axis: Axis, register: protocol.Register, value: int) -> None:
    await command(bus, axis, protocol.write(axis.id, register, value), f"a write to register {register.address}")


def facts(axes: Sequence[Axis], servos: Mapping[int, Identity]) -> dict[str, dict[str, object]]:
    """Return the properties of the servos that ``status`` shows, by name. Each value is a dict by axis key."""
    limited = {axis.key: servos[axis.id].speed_limit for axis in axes if servos[axis.id].speed_limit}
    result = facts_of({axis.key: servos[axis.id] for axis in axes})
    return {**result, "speed_limit": dict(limited)} if limited else result
