"""Set ids, baud rates and calibrations of Dynamixel servos."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.drivers.common.kit.calibration import MotorCalibration
from strands_actors.drivers.common.servo.axes import TOP, Axis
from strands_actors.drivers.common.servo.handshake import block, command
from strands_actors.drivers.common.servo.setup import ServoState, Setup
from strands_actors.drivers.common.servo.sweep import HALF_TURN

from . import protocol as p
from . import table as t
from .safing import DynamixelSafing

_INVERTED = 1


class DynamixelSetup(Setup[p.Packet]):
    CODEC = p
    SAFING = DynamixelSafing
    REGISTERS = {  # noqa: RUF012
        "mode": t.MODE,
        "drive_mode": t.DRIVE_MODE,
        "homing_offset": t.HOMING_OFFSET,
        "range_min": t.MIN_POSITION,
        "range_max": t.MAX_POSITION,
    }
    OFFSET_SIGN = -1
    OFFSET_MOVES_END = False
    HORN_TEETH = None
    _model = (t.MODEL.address, t.MODEL.size)

    async def unlock(self, axis: Axis) -> None:
        """Do nothing: a Dynamixel's EEPROM can be written whenever its torque is off."""

    async def lock(self, axis: Axis) -> None:
        """Do nothing."""

    async def read_state(self, axis: Axis) -> ServoState:
        eeprom = await block(self.bus, p, axis, 0, t.EEPROM_END)
        registers = {name: register.decode(eeprom, 0) for name, register in self.REGISTERS.items()}
        return ServoState(t.MODEL.decode(eeprom, 0), str(t.FIRMWARE.decode(eeprom, 0)), registers)

    def registers_of(self, axis: Axis, motor: MotorCalibration, present: Mapping[str, int]) -> dict[str, int]:
        return {
            "mode": self.config.modes.get(axis.key, t.EXTENDED_POSITION_MODE),
            "drive_mode": present["drive_mode"] & ~_INVERTED | motor.drive_mode,
            "homing_offset": motor.homing_offset,
            "range_min": motor.range_min,
            "range_max": motor.range_max,
        }

    def calibration_in(self, axis: Axis, registers: Mapping[str, int]) -> MotorCalibration:
        low, high = registers["range_min"], registers["range_max"]
        if not low < high <= TOP:
            low, high = 0, TOP
        return MotorCalibration(axis.id, registers["drive_mode"] & _INVERTED, registers["homing_offset"], low, high)

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
