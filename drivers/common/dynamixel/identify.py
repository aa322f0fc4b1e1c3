"""Read the registers of a Dynamixel servo, and check that it is the expected one. Its EEPROM is not changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.calibration import MotorCalibration
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus
from strands_actors.drivers.common.servo.axes import TOP, Axis
from strands_actors.drivers.common.servo.handshake import block, check_calibration, check_model
from strands_actors.drivers.common.servo.identity import facts_of

from . import protocol, table, watchdog

POSITION_MODES = (table.POSITION_MODE, table.EXTENDED_POSITION_MODE, table.CURRENT_POSITION_MODE)
ANYWHERE = (-(1 << 31), (1 << 31) - 1)
"""The range of the goal register, which covers several turns."""

_INVERTED = 1


class Identity(msgspec.Struct, frozen=True):
    """The identity, settings and state of one servo."""

    model: int
    firmware: int
    id: int
    return_delay: int
    drive_mode: int
    mode: int
    homing_offset: int
    low: int  # lowest goal position in counts; the servo applies it in mode 3 only
    high: int
    pwm_limit: int
    goal_pwm: int  # limits the torque in every position mode
    max_temperature_c: float
    min_voltage_v: float
    max_voltage_v: float
    torque: bool
    hardware_error: int
    voltage_v: float
    temperature_c: float

    @property
    def model_name(self) -> str:
        return table.MODEL_NUMBERS.get(self.model, f"model {self.model}")

    @property
    def travel(self) -> tuple[int, int]:
        """Lowest and highest goal position that the servo accepts, in counts. In mode 3 the servo refuses goals
        beyond its limit registers; in the other modes it accepts any number of turns."""
        return (self.low, self.high) if self.mode == table.POSITION_MODE else ANYWHERE


def reach(axis: Axis, servo: Identity, calibrated: bool) -> tuple[int, int]:
    """Return the range of counts in which the joint may be when it is energised.

    A servo that counts whole turns may be outside this range. Such a servo must not be energised, because it would
    turn all the way back at the first command.
    """
    if servo.mode == table.POSITION_MODE:
        return servo.travel
    return (axis.low, axis.high) if calibrated else (0, TOP)


async def identify(bus: HalfDuplexBus[protocol.Packet], axis: Axis) -> Identity:
    """Read the registers of one servo. Raise ``WireDown`` if it does not answer."""
    base = table.EEPROM_END
    eeprom = await block(bus, protocol, axis, 0, base)
    ram = await block(bus, protocol, axis, base, table.TEMPERATURE.address + table.TEMPERATURE.size - base)
    return Identity(
        model=table.MODEL.decode(eeprom, 0),
        firmware=table.FIRMWARE.decode(eeprom, 0),
        id=table.ID.decode(eeprom, 0),
        return_delay=table.RETURN_DELAY.decode(eeprom, 0),
        drive_mode=table.DRIVE_MODE.decode(eeprom, 0),
        mode=table.MODE.decode(eeprom, 0),
        homing_offset=table.HOMING_OFFSET.decode(eeprom, 0),
        low=table.MIN_POSITION.decode(eeprom, 0),
        high=table.MAX_POSITION.decode(eeprom, 0),
        pwm_limit=table.PWM_LIMIT.decode(eeprom, 0),
        goal_pwm=table.GOAL_PWM.decode(ram, base),
        max_temperature_c=float(table.MAX_TEMPERATURE.decode(eeprom, 0)),
        min_voltage_v=table.MIN_VOLTAGE.decode(eeprom, 0) / 10,
        max_voltage_v=table.MAX_VOLTAGE.decode(eeprom, 0) / 10,
        torque=bool(table.TORQUE_ENABLE.decode(ram, base)),
        hardware_error=table.HARDWARE_ERROR.decode(ram, base),
        voltage_v=table.VOLTAGE.decode(ram, base) / 10,
        temperature_c=float(table.TEMPERATURE.decode(ram, base)),
    )


def check(axis: Axis, servo: Identity, motor: MotorCalibration | None) -> None:
    """Raise ``WireDown`` unless the servo is of the model in the robot's table, and its registers have the values
    of the calibration."""
    check_model(axis, servo.id, servo.model, protocol)
    if servo.mode not in POSITION_MODES:
        name = table.MODE_NAMES.get(servo.mode, "unknown")
        raise WireDown(
            f"{axis.label} is in mode {servo.mode} ({name}), must be in mode 3, 4 or 5 (a position mode). "
            "Calibrate the servo again"
        )
    if motor is not None:
        servo_values = {
            "homing_offset": servo.homing_offset,
            "range_min": servo.low,
            "range_max": servo.high,
            "drive_mode": servo.drive_mode & _INVERTED,
        }
        check_calibration(axis, motor, servo_values)


def facts(axes: Sequence[Axis], servos: Mapping[int, Identity]) -> dict[str, dict[str, object] | float]:
    """Return the properties of the servos that ``status`` shows, by name. The value of a property is a dict by axis
    key, or a single number for all servos."""
    by_key = {axis.key: servos[axis.id] for axis in axes}
    return {
        **facts_of(by_key),
        "operating_mode": {key: table.MODE_NAMES[servo.mode] for key, servo in by_key.items()},
        "return_delay_us": {key: servo.return_delay * 2 for key, servo in by_key.items()},
        "hardware_alert": {key: table.error_words(servo.hardware_error) for key, servo in by_key.items()},
        "bus_watchdog_s": watchdog.SECONDS,
    }
