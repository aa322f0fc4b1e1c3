"""Set the ids and the calibration of servos when a robot is built. Nothing here energises a servo.

The robot must not be in use by another process meanwhile, because this process needs the port for itself.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Generic, NamedTuple

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.calibration import MotorCalibration
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus, PacketT
from strands_actors.drivers.common.ports.serial_port import BytePort, open_serial
from strands_actors.kernel.clock import Clock

from .axes import MIDDLE, TOP, Axis
from .codec import Codec
from .config import ServoConfig
from .handshake import ANSWER_S, block, check_model, command, roll_call
from .safing import Safing, safing_on

HALF_TURN = MIDDLE - 1
"""The count at the middle of a joint: half of 4095, as in lerobot."""

SEEK_S = 0.1
SLOT_S = 0.003
"""Slot of one id after a broadcast ping [assumed, as at the roll call]."""


class FoundServo(NamedTuple):
    """A servo that answers: the baud rate of its bus, and its id."""

    baud: int
    id: int


class Setup(ABC, Generic[PacketT]):
    """Set up the servos of one robot or leader arm on a port. Every method raises ``WireDown`` if it fails.

    A subclass provides the codec, the ``Safing`` class, and the methods that depend on the protocol.
    """

    CODEC: Codec[PacketT]
    SAFING: type[Safing[PacketT]]

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
    async def read_calibration(self, axis: Axis) -> MotorCalibration:
        """Read the calibration that the servo has now, even if it is not valid."""

    @abstractmethod
    async def write_calibration(self, axis: Axis, motor: MotorCalibration) -> None:
        """Write the calibration and the operating mode of the joint's servo."""

    @abstractmethod
    def offset_to_middle(self, position: int) -> int:
        """Return the homing offset with which a servo reports ``HALF_TURN`` at ``position``, which was read without
        an offset."""

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


# -- the recorded ranges; pure

LEAST_COUNTS = 200
"""Least travel of a joint, 18 degrees. With less it was not moved at all."""

MOST_COUNTS = 4000
"""Largest travel of a joint. With more it has passed the end of its encoder, because it did not start in its
middle."""


class Ranges:
    """The lowest and the highest count of each joint that was recorded so far.

    Args:
        axes: The joints.
        whole_turn: Keys of joints that turn without an end.
    """

    def __init__(self, axes: Sequence[Axis], whole_turn: Sequence[str]) -> None:
        self.low = {axis.key: MIDDLE for axis in axes}
        self.high = dict(self.low)
        self.now: Mapping[str, int] = {}
        self._whole_turn = frozenset(whole_turn)
        self._wrapped: set[str] = set()

    def record(self, positions: Mapping[str, int]) -> None:
        """Record the next positions. The joints must be read so often that a hand cannot turn one by half a turn in
        between."""
        for key, count in positions.items():
            before = self.now.get(key, count)
            if abs(count - before) > MIDDLE:
                self._wrapped.add(key)
            first = key not in self.now
            self.low[key] = count if first else min(self.low[key], count)
            self.high[key] = count if first else max(self.high[key], count)
        self.now = dict(positions)

    def of(self, key: str) -> tuple[int, int]:
        return (0, TOP) if key in self._whole_turn else (self.low[key], self.high[key])

    def problems(self) -> dict[str, str]:
        """Return the problem of each joint whose recorded range cannot be used."""
        problems = {}
        for key in self.low:
            if key in self._whole_turn:
                continue
            counts = self.high[key] - self.low[key]
            if self.low[key] < 0 or self.high[key] > TOP:
                span = f"{self.low[key]} to {self.high[key]}"
                problems[key] = f"went from {span}, past its encoder's 0 to {TOP}: begin with it in its middle"
            elif counts < LEAST_COUNTS:
                problems[key] = "was hardly moved"
            elif key in self._wrapped or counts > MOST_COUNTS:
                problems[key] = "passed the end of its encoder: begin with it in its middle"
        return problems
