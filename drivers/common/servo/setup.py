"""Set the ids and the calibration of servos when a robot is built. Nothing here energises a servo.

The robot must not be in use by another process meanwhile, because this process needs the port for itself.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, Protocol

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.calibration import MotorCalibration
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus, PacketT
from strands_actors.drivers.common.ports.serial_port import BytePort, open_serial
from strands_actors.kernel.clock import Clock

from .axes import Axis
from .codec import Codec
from .config import ServoConfig
from .handshake import ANSWER_S, block, check_model, command, roll_call
from .safing import Safing, safing_on

SEEK_S = 0.1
SLOT_S = 0.003
"""Slot of one id after a broadcast ping [assumed, as at the roll call]."""


class FoundServo(NamedTuple):
    """A servo that answers: the baud rate of its bus, and its id."""

    baud: int
    id: int


class Register(Protocol):
    """One register that a calibration writes."""

    @property
    def address(self) -> int: ...
    def encode(self, value: int) -> bytes: ...
    def decode(self, data: bytes, base: int | None = None) -> int: ...


class ServoState(NamedTuple):
    """What one servo has stored: its model number, its firmware, and the registers that a calibration writes, by
    name."""

    model: int
    firmware: str
    registers: Mapping[str, int]


class Setup(ABC, Generic[PacketT]):
    """Set up the servos of one robot or leader arm on a port. Every method raises ``WireDown`` if it fails.

    A subclass provides the codec, the ``Safing`` class, and the methods that depend on the protocol.
    """

    CODEC: Codec[PacketT]
    SAFING: type[Safing[PacketT]]
    REGISTERS: Mapping[str, Register]
    """The registers that a calibration writes, by name, in the order in which they are written."""
    OFFSET_SIGN: int
    """1 if the servo subtracts its homing offset from the encoder's count, -1 if it adds it."""
    OFFSET_MOVES_END: bool
    """True if the homing offset also moves the position at which the servo starts to count at 0 again."""
    HORN_TEETH: int | None
    """The number of teeth of the servo's shaft; None if it is not known."""

    def __init__(
        self, config: ServoConfig, clock: Clock, open_port: Callable[[str, int], BytePort] = open_serial
    ) -> None:
        self.config = config
        self.axes = config.joints
        self.clock = clock
        self._open_port = open_port
        self._port: BytePort | None = None
        self._bus: HalfDuplexBus[PacketT] | None = None

    # -- methods that depend on the protocol

    @abstractmethod
    async def unlock(self, axis: Axis) -> None:
        """Allow writes to registers that keep their value without power."""

    @abstractmethod
    async def lock(self, axis: Axis) -> None: ...

    @abstractmethod
    async def read_state(self, axis: Axis) -> ServoState:
        """Read what the servo has stored."""

    @abstractmethod
    def registers_of(self, axis: Axis, motor: MotorCalibration, present: Mapping[str, int]) -> dict[str, int]:
        """Return the values of ``REGISTERS`` for a calibration.

        Args:
            axis: The joint.
            motor: The calibration.
            present: The present values.
        """

    @abstractmethod
    def calibration_in(self, axis: Axis, registers: Mapping[str, int]) -> MotorCalibration:
        """Return the calibration that the registers contain. An invalid range counts as a whole turn."""

    @abstractmethod
    def offset_to_middle(self, position: int) -> int:
        """Return the homing offset with which a servo reports ``HALF_TURN`` at ``position``, a count of its
        encoder."""

    @abstractmethod
    async def _write(self, servo: int, axis: Axis, register: Any, value: int) -> None:
        """Write one register of the servo with the id ``servo``."""

    @abstractmethod
    async def give(self, servo: int, axis: Axis, baud: int) -> None:
        """Set the id of a joint and the baud rate of its bus on a servo. No other servo may be on the bus."""

    # -- common parts

    @property
    def bus(self) -> HalfDuplexBus[PacketT]:
        if self._bus is None:
            raise WireDown("the port is not open")
        return self._bus

    async def open(self) -> None:
        """Open the port. Check that all servos of the robot answer, and switch off their torque."""
        config = self.config
        self._open(config.baud)
        await roll_call(
            self.bus, self.CODEC, config.robot, self.axes, f"{config.port} at {config.baud} baud", config.others
        )
        assert self._port is not None
        reports = await safing_on(self._port, config, self.CODEC, self.SAFING, self.clock).limp()
        if stiff := [report.axis for report in reports if not report.safe]:
            raise WireDown(f"{', '.join(stiff)} may still have torque. Check cables and power")

    async def positions(self) -> dict[str, int]:
        """Read the position of each servo, in counts by joint."""
        register, ids = self.CODEC.POSITION, self.config.ids
        request = self.CODEC.sync_read(ids, register.address, register.size)
        replies = await self.bus.transact(request, dict.fromkeys(ids, register.size), ANSWER_S, wait=True)
        if mute := [axis.label for axis in self.axes if axis.id not in replies]:
            raise WireDown(f"{', '.join(mute)} does not answer. Check cables and power")
        return {axis.key: register.decode(replies[axis.id].params) for axis in self.axes}

    async def write_registers(self, axis: Axis, values: Mapping[str, int]) -> None:
        """Write the registers of a calibration, and read them back.

        Args:
            axis: The joint.
            values: The value of each of ``REGISTERS``.
        """
        await self.unlock(axis)
        for name, register in self.REGISTERS.items():
            await self._write(axis.id, axis, register, values[name])
        await self.lock(axis)
        if (await self.read_state(axis)).registers != values:
            raise WireDown(f"{axis.label} did not keep its new values. Check its cable, then try again")

    async def seek(self, bauds: Sequence[int] = ()) -> list[FoundServo]:
        """Find all servos that answer at one of ``bauds``. The default tries every baud rate."""
        servos: list[FoundServo] = []
        for baud in bauds or self.CODEC.BAUD_RATES:
            self._open(baud)
            replies = await self.bus.listen(
                self.CODEC.ping(self.CODEC.BROADCAST), SEEK_S + SLOT_S * self.CODEC.BROADCAST, SEEK_S
            )
            servos += [FoundServo(baud, servo_id) for servo_id in sorted({packet.id for packet in replies})]
        return servos

    async def adopt(self, servo: FoundServo, axis: Axis) -> None:
        """Set id and baud rate of the only servo on the bus to those of a joint, and check that it answers."""
        self._open(servo.baud)
        codec, model = self.CODEC, self._model
        params = await block(self.bus, codec, _named(axis, servo.id), *model)
        number = int.from_bytes(params[:2], "little")
        check_model(axis, axis.id, number, codec)
        await command(self.bus, _named(axis, servo.id), codec.torque(servo.id, False), "torque off")
        await self.give(servo.id, axis, self.config.baud)
        self._open(self.config.baud)
        replies = await self.bus.listen(codec.ping(axis.id), ANSWER_S, SEEK_S)
        if [packet.id for packet in replies] != [axis.id]:
            raise WireDown(f"{axis.label} does not answer at its new id. Power-cycle it, then try again")

    @property
    @abstractmethod
    def _model(self) -> tuple[int, int]:
        """Address and size of the register that holds the model number."""

    def close(self) -> None:
        port, self._port, self._bus = self._port, None, None
        if port is not None:
            port.close()

    def _open(self, baud: int) -> None:
        self.close()
        self._port = self._open_port(self.config.port, baud)
        codec = self.CODEC
        self._bus = HalfDuplexBus(self._port, codec.Decoder(), self.clock, baud, overhead=codec.OVERHEAD)


def _named(axis: Axis, servo: int) -> Axis:
    """Return a copy of the joint ``axis`` in which ``servo`` is the id of its servo."""
    return Axis(**{**{name: getattr(axis, name) for name in Axis.__struct_fields__}, "id": servo})
