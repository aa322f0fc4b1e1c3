"""Set ids and calibration of Feetech servos."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.drivers.common.kit.calibration import MotorCalibration
from strands_actors.drivers.common.servo.axes import Axis
from strands_actors.drivers.common.servo.handshake import block, command
from strands_actors.drivers.common.servo.setup import ServoState, Setup
from strands_actors.drivers.common.servo.sweep import HALF_TURN

from . import protocol as p
from .identify import POSITION_MODE
from .safing import FeetechSafing

_LOCKED, _OPEN = 1, 0


class FeetechSetup(Setup[p.Packet]):
    CODEC = p
    SAFING = FeetechSafing
    REGISTERS = {  # noqa: RUF012
        "mode": p.MODE,
        "homing_offset": p.HOMING_OFFSET,
        "range_min": p.MIN_POSITION,
        "range_max": p.MAX_POSITION,
    }
    OFFSET_SIGN = 1
    OFFSET_MOVES_END = True
    HORN_TEETH = 25
    """Of the STS3215's output shaft, in its data sheet (25T)."""
    _model = (p.MODEL.address, p.MODEL.size)

    async def unlock(self, axis: Axis) -> None:
        await self._write(axis.id, axis, p.LOCK, _OPEN)

    async def lock(self, axis: Axis) -> None:
        await self._write(axis.id, axis, p.LOCK, _LOCKED)

    async def read_state(self, axis: Axis) -> ServoState:
        eeprom = await block(self.bus, p, axis, 0, p.EEPROM_END)
        registers = {name: register.decode(eeprom, 0) for name, register in self.REGISTERS.items()}
        return ServoState(p.MODEL.decode(eeprom, 0), f"{eeprom[0]}.{eeprom[1]}", registers)

    def registers_of(self, axis: Axis, motor: MotorCalibration, present: Mapping[str, int]) -> dict[str, int]:
        return {
            "mode": POSITION_MODE,
            "homing_offset": motor.homing_offset,
            "range_min": motor.range_min,
            "range_max": motor.range_max,
        }

    def calibration_in(self, axis: Axis, registers: Mapping[str, int]) -> MotorCalibration:
        low, high = registers["range_min"], registers["range_max"]
        # Both position limits are zero in a servo that may turn more than one turn.
        if not low < high <= p.COUNTS - 1:
            low, high = 0, p.COUNTS - 1
        return MotorCalibration(axis.id, 0, registers["homing_offset"], low, high)

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
