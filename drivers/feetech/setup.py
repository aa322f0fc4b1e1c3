"""Set ids and calibration of Feetech servos."""

from __future__ import annotations

from strands_actors.drivers.common.kit.calibration import MotorCalibration
from strands_actors.drivers.common.servo.axes import Axis
from strands_actors.drivers.common.servo.handshake import block, command
from strands_actors.drivers.common.servo.setup import HALF_TURN, Setup

from . import protocol as p
from .identify import POSITION_MODE
from .safing import FeetechSafing

_LOCKED, _OPEN = 1, 0


class FeetechSetup(Setup[p.Packet]):
    CODEC = p
    SAFING = FeetechSafing
    _model = (p.MODEL.address, p.MODEL.size)

    async def unlock(self, axis: Axis) -> None:
        await self._write(axis.id, axis, p.LOCK, _OPEN)

    async def lock(self, axis: Axis) -> None:
        await self._write(axis.id, axis, p.LOCK, _LOCKED)

    async def read_calibration(self, axis: Axis) -> MotorCalibration:
        eeprom = await block(self.bus, p, axis, 0, p.EEPROM_END)
        low, high = p.MIN_POSITION.decode(eeprom, 0), p.MAX_POSITION.decode(eeprom, 0)
        # Both position limits are zero in a servo that may turn more than one turn.
        if not low < high <= p.COUNTS - 1:
            low, high = 0, p.COUNTS - 1
        return MotorCalibration(axis.id, 0, p.HOMING_OFFSET.decode(eeprom, 0), low, high)

    async def write_calibration(self, axis: Axis, motor: MotorCalibration) -> None:
        for register, value in (
            (p.MODE, POSITION_MODE),
            (p.HOMING_OFFSET, motor.homing_offset),
            (p.MIN_POSITION, motor.range_min),
            (p.MAX_POSITION, motor.range_max),
        ):
            await self._write(axis.id, axis, register, value)

    def offset_to_middle(self, position: int) -> int:
        """Return the homing offset for which the servo reports half a turn at ``position``. The servo subtracts the
        offset from its reading."""
        return position - HALF_TURN

    async def give(self, servo: int, axis: Axis, baud: int) -> None:
        await self._write(servo, axis, p.LOCK, _OPEN)
        await self._write(servo, axis, p.ID, axis.id)
        # Unlock the EEPROM again under the new id, since some firmware requires it.
        await self._write(axis.id, axis, p.LOCK, _OPEN)
        # The reply may come at the old or at the new baud rate, so it is not read.
        self.bus.send(p.write(axis.id, p.BAUD, p.BAUD_RATES.index(baud)))
        await self.clock.sleep_until_ns(self.clock.now_ns() + 50_000_000)
        self._open(baud)
        await self._write(axis.id, axis, p.LOCK, _LOCKED)

    async def _write(self, servo: int, axis: Axis, register: p.Register, value: int) -> None:
        named = Axis(**{**{name: getattr(axis, name) for name in Axis.__struct_fields__}, "id": servo})
        await command(self.bus, named, p.write(servo, register, value), f"a write to register {register.address}")
