"""Set ids, baud rates and calibrations of Dynamixel servos."""

from __future__ import annotations

from strands_actors.drivers.common.kit.calibration import MotorCalibration
from strands_actors.drivers.common.servo.axes import TOP, Axis
from strands_actors.drivers.common.servo.handshake import block, command
from strands_actors.drivers.common.servo.setup import HALF_TURN, Setup

from . import protocol as p
from . import table as t
from .safing import DynamixelSafing

_INVERTED = 1


class DynamixelSetup(Setup[p.Packet]):
    CODEC = p
    SAFING = DynamixelSafing
    _model = (t.MODEL.address, t.MODEL.size)

    async def unlock(self, axis: Axis) -> None:
        """Do nothing: a Dynamixel's EEPROM can be written whenever its torque is off."""

    async def lock(self, axis: Axis) -> None:
        """Do nothing."""

    async def read_calibration(self, axis: Axis) -> MotorCalibration:
        eeprom = await block(self.bus, p, axis, 0, t.EEPROM_END)
        low, high = t.MIN_POSITION.decode(eeprom, 0), t.MAX_POSITION.decode(eeprom, 0)
        if not low < high <= TOP:
            low, high = 0, TOP
        inverted = t.DRIVE_MODE.decode(eeprom, 0) & _INVERTED
        return MotorCalibration(axis.id, inverted, t.HOMING_OFFSET.decode(eeprom, 0), low, high)

    async def write_calibration(self, axis: Axis, motor: MotorCalibration) -> None:
        eeprom = await block(self.bus, p, axis, 0, t.EEPROM_END)
        others = t.DRIVE_MODE.decode(eeprom, 0) & ~_INVERTED
        for register, value in (
            (t.MODE, self.config.modes.get(axis.key, t.EXTENDED_POSITION_MODE)),
            (t.DRIVE_MODE, others | motor.drive_mode),
            (t.HOMING_OFFSET, motor.homing_offset),
            (t.MIN_POSITION, motor.range_min),
            (t.MAX_POSITION, motor.range_max),
        ):
            await self._write(axis.id, axis, register, value)

    def offset_to_middle(self, position: int) -> int:
        """Return the homing offset with which a servo at ``position`` reports ``HALF_TURN``. The servo adds the
        offset to the measured position."""
        return HALF_TURN - position

    async def give(self, servo: int, axis: Axis, baud: int) -> None:
        await self._write(servo, axis, t.ID, axis.id)
        # The servo may acknowledge this write at the old or at the new baud rate, so no answer is awaited.
        self.bus.send(p.write(axis.id, t.BAUD, t.BAUD_RATES.index(baud)))
        await self.clock.sleep_until_ns(self.clock.now_ns() + 50_000_000)

    async def _write(self, servo: int, axis: Axis, register: t.Register, value: int) -> None:
        named = Axis(**{**{name: getattr(axis, name) for name in Axis.__struct_fields__}, "id": servo})
        await command(self.bus, named, p.write(servo, register, value), f"a write to register {register.address}")
