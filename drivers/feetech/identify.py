"""Hello: who is on the bus, is it the robot we were told, and is it the one that was calibrated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.drivers.common.calibration import MotorCalibration
from strands_actors.runtime.contract import WireDown

from . import protocol
from .axes import TOP, Axis
from .safing import Bus

PING_S = 0.15
"""A servo answers within its return delay (0.5 ms); the rest is for the adapter and a busy host. Only a
missing servo costs it, as ``ANSWER_S``."""

PING_SILENCE_S = 0.004
ROLL_CALL_S = 0.05
ROLL_CALL_SLOT_S = 0.003
"""A broadcast ping: servos answer one after the other, in slots by id (assumed, after lerobot's wait)."""

ANSWER_S = 0.25
POSITION_MODE = 0

_MODELS = {name: number for number, name in protocol.MODEL_NUMBERS.items()}
_RAM = protocol.TORQUE_ENABLE.address
_RAM_SIZE = protocol.TABLE_SIZE - _RAM - 20  # to register 69


class Identity(msgspec.Struct, frozen=True):
    """What one servo says about itself."""

    model: int
    firmware: str
    id: int
    return_delay: int
    low: int  # goals it takes, counts
    high: int
    homing_offset: int
    mode: int
    max_temperature_c: float
    min_voltage_v: float
    max_voltage_v: float
    torque: bool
    locked: bool
    voltage_v: float
    temperature_c: float

    @property
    def model_name(self) -> str:
        return protocol.MODEL_NUMBERS.get(self.model, f"model {self.model}")

    @property
    def travel(self) -> tuple[int, int]:
        """0, 0 in the registers means several turns: then one turn, as our units."""
        return (self.low, self.high) if self.high > self.low else (0, TOP)


async def roll_call(bus: Bus, robot: str, axes: Sequence[Axis], where: str) -> None:
    """Ping each servo, then all at once. Raise ``WireDown`` naming missing, double and foreign servos."""
    heard: Counter[int] = Counter()
    garbled: set[int] = set()
    for axis in axes:
        answers = await bus.listen(protocol.ping(axis.id), PING_S, PING_SILENCE_S)
        heard[axis.id] = sum(packet.id == axis.id for packet in answers)
        if bus.stray_bytes:
            garbled.add(axis.id)
    slots_s = ROLL_CALL_SLOT_S * max(axis.id for axis in axes)
    everybody = await bus.listen(protocol.ping(protocol.BROADCAST), ROLL_CALL_S + slots_s, ROLL_CALL_S)
    present = Counter(packet.id for packet in everybody)

    expected = {axis.id: axis for axis in axes}
    twice = [
        axis.label for motor, axis in expected.items() if motor in garbled or heard[motor] > 1 or present[motor] > 1
    ]
    missing = [axis.label for motor, axis in expected.items() if not heard[motor] and motor not in garbled]
    foreign = sorted(motor for motor in present if motor not in expected)
    if len(missing) == len(axes):
        raise WireDown(
            f"connect: no servo of {robot} answers on {where}. Check power, the bus cable, port= and baud="
        )
    wrong = []
    if missing:
        wrong.append(f"{', '.join(missing)} does not answer")
    if twice:
        wrong.append(f"{', '.join(twice)} answers more than once or garbled: two servos with one id?")
    if foreign:
        wrong.append(f"{', '.join(f'id {motor}' for motor in foreign)} is not of {robot}")
    if wrong:
        raise WireDown(f"connect: {'; '.join(wrong)}. Check cables and ids; {robot} has ids {_ids(axes)}")


async def identify(bus: Bus, axis: Axis) -> Identity:
    """Read one servo's registers. Raise ``WireDown``."""
    eeprom = await _block(bus, axis, 0, protocol.EEPROM_END)
    ram = await _block(bus, axis, _RAM, _RAM_SIZE)

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
        max_temperature_c=float(protocol.MAX_TEMPERATURE.decode(eeprom, 0)),
        min_voltage_v=tenths(protocol.MIN_VOLTAGE, eeprom, 0),
        max_voltage_v=tenths(protocol.MAX_VOLTAGE, eeprom, 0),
        torque=bool(protocol.TORQUE_ENABLE.decode(ram, _RAM)),
        locked=bool(protocol.LOCK.decode(ram, _RAM)),
        voltage_v=tenths(protocol.VOLTAGE, ram, _RAM),
        temperature_c=float(protocol.TEMPERATURE.decode(ram, _RAM)),
    )


def check(axis: Axis, servo: Identity, motor: MotorCalibration | None) -> None:
    """Refuse a servo that is not the one of the table, or not the one that was calibrated."""
    wanted = _MODELS.get(axis.model)
    if wanted is not None and servo.model != wanted:
        raise WireDown(
            f"connect: {axis.label} is a {servo.model_name}, must be {axis.model}. "
            "Check which robot is on this port"
        )
    if servo.id != axis.id:
        raise WireDown(f"connect: {axis.label} says its id is {servo.id}. Set its id again")
    if servo.mode != POSITION_MODE:
        raise WireDown(f"connect: {axis.label} is in mode {servo.mode}, must be 0 (position). Set register 33 to 0")
    if motor is None:
        return
    for field, filed, found in (
        ("homing_offset", motor.homing_offset, servo.homing_offset),
        ("range_min", motor.range_min, servo.low),
        ("range_max", motor.range_max, servo.high),
    ):
        if filed != found:
            raise WireDown(
                f"connect: calibration says {field} {filed} for {axis.key}, servo {axis.id} has {found}. "
                "Use the file of this robot, or calibrate it again"
            )


async def answer_at_once(bus: Bus, axis: Axis, servo: Identity) -> None:
    """Return delay 0, behind the lock: gone at the next power off, no wear. Raise ``WireDown``."""
    if not servo.locked:
        await command(bus, axis, protocol.LOCK, 1)
    if servo.return_delay:
        await command(bus, axis, protocol.RETURN_DELAY, 0)


async def command(bus: Bus, axis: Axis, register: protocol.Register, value: int) -> None:
    """One acknowledged write. Raise ``WireDown``."""
    replies = await bus.transact(protocol.write(axis.id, register, value), {axis.id: 0}, ANSWER_S, wait=True)
    if axis.id not in replies:
        raise WireDown(_unanswered(bus, axis, f"a write to register {register.address}"))


async def _block(bus: Bus, axis: Axis, address: int, size: int) -> bytes:
    replies = await bus.transact(protocol.read(axis.id, address, size), {axis.id: size}, ANSWER_S, wait=True)
    if axis.id not in replies:
        raise WireDown(_unanswered(bus, axis, f"a read of register {address}"))
    return replies[axis.id].params


def _unanswered(bus: Bus, axis: Axis, what: str) -> str:
    if bus.stray_bytes:
        return f"connect: {axis.label} garbles its answer to {what}. Two servos with one id, or a bad cable?"
    return f"connect: {axis.label} does not answer {what}. Check its cable and power"


def _ids(axes: Sequence[Axis]) -> str:
    return ", ".join(str(axis.id) for axis in axes)


def facts(axes: Sequence[Axis], servos: Mapping[int, Identity]) -> dict[str, dict[str, object]]:
    """For ``status``: by axis key."""
    rows = [(axis.key, servos[axis.id]) for axis in axes]
    return {
        "model": {key: servo.model_name for key, servo in rows},
        "firmware": {key: servo.firmware for key, servo in rows},
        "voltage_v": {key: servo.voltage_v for key, servo in rows},
        "temperature_c": {key: servo.temperature_c for key, servo in rows},
        "energised": {key: servo.torque for key, servo in rows},
    }
