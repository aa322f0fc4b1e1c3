"""Answer the frames on each port of the simulated robot: a board that answers calls, or a chain of servos."""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple, Protocol

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.dynamixel import protocol as dxl
from strands_actors.drivers.common.dynamixel.twin import DynamixelBus
from strands_actors.drivers.common.twin import Exchange, Fault, Reply
from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.stretch import frames as f
from strands_actors.drivers.stretch import protocol as p
from strands_actors.drivers.stretch.config import ARM, LEFT, LIFT, RIGHT

from .calls import NO_REPLY, PIMU_CALLS, PIMU_TRIGGERS, STEPPER_CALLS, STEPPER_TRIGGERS, WACC_CALLS
from .stepper import FIRMWARE, PROTOCOL, VARIANT, StepperMotor
from .trajectory import segment_of
from .world import WACC_NUMBER, World

STEPPER_TYPES = {LEFT: 1, RIGHT: 2, ARM: 3, LIFT: 4}
"""Types of the steppers, as the boards have them in flash."""

WRONG_RAD = 50.0
"""Error of the reported position of a stepper with wrong readings."""


class ReceivedFrame(NamedTuple):
    """One frame from the host. ``act`` carries out the frame."""

    kind: str
    act: Callable[[], Exchange]


class DeviceDecoder(Protocol):
    def frames(self, data: bytes, bits_per_s: int | None) -> Iterator[ReceivedFrame]:
        """Split received bytes into frames, without carrying them out."""
        ...


class BoardDecoder(ABC):
    """Decodes and answers the frames to one board: both transports, and the calls of its kind. ``number`` is
    the board's unit number for faults."""

    CALLS: Modelled[int]
    INFO_CALL: int
    INFO: tuple[str, str]
    stepper_type: int | None = None

    def __init__(self, world: World, number: int) -> None:
        self.world = world
        self.number = number
        self._decoder = f.Decoder()
        self._call = b""
        self._pending: Iterator[bytes] = iter(())
        self._pending_v0 = b""
        self._stuck: bytes | None = None

    @abstractmethod
    def do(self, call: int, data: bytes) -> bytes:
        """Carry out a call. Return its reply, without the number at its start. Raise ``MalformedFrame``."""

    @abstractmethod
    def kind_of(self, call: int, data: bytes) -> str:
        """Return the kind of a call for the log of messages. Raise ``MalformedFrame``."""

    @property
    def fault(self) -> Fault:
        return self.world.faults.of(self.number)

    def frames(self, data: bytes, bits_per_s: int | None) -> Iterator[ReceivedFrame]:
        for frame in self._decoder.feed(data):
            yield ReceivedFrame(self._kind(frame), partial(self._act, frame))

    def _kind(self, frame: f.Frame) -> str:
        """Return the kind of the call that a frame completes. A frame with an earlier part of a call has no
        effect yet."""
        if frame.code in (f.PULL_FIRST, f.PULL_NEXT, f.V0_START, f.V0_SEND_LAST, f.V0_GET):
            return "read"
        call = {f.PUSH_ONLY: frame.data, f.PUSH_LAST: self._call + frame.data}.get(frame.code, b"")
        try:
            return self.kind_of(call[0], call[1:]) if call else "other"
        except MalformedFrame:
            return "other"

    def _act(self, frame: f.Frame) -> Exchange:
        request = f.frame(*frame)
        if self.fault is Fault.OFF:
            return Exchange("other", request, ())
        self.world.pass_time()
        kind = self._kind(frame)
        answer = self._answer(frame)
        replies = () if answer is None else (Reply(0.0, answer, self.number, kind),)
        faulty = [reply for each in replies if (reply := self.world.faults.apply(each)) is not None]
        return Exchange(kind, request, faulty, self.world.safe_state if kind == "safe" else None)

    def _answer(self, frame: f.Frame) -> bytes | None:
        """Return the frame that answers a frame of the host; None if it needs no answer."""
        match frame.code:
            case f.PUSH_ONLY:
                return f.frame(f.PUSH_ACK, self._reply(frame.data)[: f.CHUNK_V1])
            case f.PUSH_FIRST | f.PUSH_MORE:
                first = frame.code == f.PUSH_FIRST
                self._call = (b"" if first else self._call)[: f.MAX_CALL] + frame.data
                return f.frame(f.PUSH_ACK)
            case f.PUSH_LAST:
                call, self._call = self._call + frame.data, b""
                return f.frame(f.PUSH_ACK, self._reply(call)[: f.CHUNK_V1])
            case f.PULL_FIRST:
                self._pending = f.answers(self._reply(frame.data))
                return next(self._pending)
            case f.PULL_NEXT:
                return next(self._pending, f.frame(f.PULL_LAST))
            case f.V0_START:
                self._call = b""
                return f.frame(f.V0_STARTED)
            case f.V0_SEND_MORE:
                self._call = self._call[: f.MAX_CALL] + frame.data
                return f.frame(f.V0_SENT_MORE)
            case f.V0_SEND_LAST:
                call, self._call = self._call + frame.data, b""
                self._pending_v0 = self._reply(call)
                return f.frame(f.V0_SENT_LAST)
            case f.V0_GET:
                chunk, self._pending_v0 = self._pending_v0[: f.CHUNK_V0], self._pending_v0[f.CHUNK_V0 :]
                return f.frame(f.V0_GOT_MORE if self._pending_v0 else f.V0_GOT_LAST, chunk)
        return None

    def _reply(self, call: bytes) -> bytes:
        if not call or call[0] not in self.CALLS:
            return NO_REPLY
        if call[0] == self.INFO_CALL:
            return bytes((call[0] + 1,)) + p.board_info_reply(*self.INFO, self.stepper_type)
        try:
            return bytes((call[0] + 1,)) + self.do(call[0], call[1:])
        except MalformedFrame:
            return NO_REPLY


class StepperDecoder(BoardDecoder):
    CALLS = STEPPER_CALLS
    INFO_CALL = p.BOARD_INFO[p.Kind.STEPPER]
    INFO = (VARIANT, FIRMWARE)

    def __init__(self, world: World, motor: StepperMotor) -> None:
        super().__init__(world, motor.number)
        self.stepper_type = STEPPER_TYPES[motor.name]
        self._motor = motor
        self._cycles = 0

    def kind_of(self, call: int, data: bytes) -> str:
        if call == p.COMMAND:
            return p.parse_command(data).kind
        return "config" if call in (p.GAINS, p.TRIGGER, p.MOTION_LIMITS) else "other"

    def do(self, call: int, data: bytes) -> bytes:
        motor = self._motor
        match call:
            case p.COMMAND:
                motor.take(p.parse_command(data))
                self._cycles = self._cycles + 1 & 0xFFFF
                return struct.pack("<H", self._cycles)
            case p.STATUS:
                return p.pack_stepper_status(self._status(), PROTOCOL)
            case p.GAINS:
                motor.gains = p.parse_gains(data)
            case p.TRIGGER:
                bits, value = p.parse_trigger(data)
                _check_bits(bits, STEPPER_TRIGGERS)
                motor.trigger(bits, value)
            case p.FLASH_GAINS:
                return motor.flash.pack(PROTOCOL)
            case p.MOTION_LIMITS:
                motor.limits = p.parse_motion_limits(data)
            case p.START_TRAJECTORY:
                return bytes((motor.start_trajectory(segment_of(data)),))
            case p.NEXT_SEGMENT:
                motor.trajectory.append(segment_of(data))
                return b"\1"
            case p.RESET_TRAJECTORY:
                motor.trajectory.reset()
                return b"\1"
            case p.STATUS_AUX:
                return struct.pack("<5H", self._cycles, self._cycles, 0, self.world.syncs & 0xFFFF, 0)
        return b""

    def _status(self) -> p.StepperStatus:
        """Return the status of the board. A board with the fault "stuck" repeats its last status."""
        if self.fault is not Fault.STUCK:
            self._frozen = self._motor.status()
        frozen = self._frozen
        wrong = WRONG_RAD if self.fault is Fault.WRONG else 0.0
        return frozen._replace(position=frozen.position + wrong)


class PimuDecoder(BoardDecoder):
    CALLS = PIMU_CALLS
    INFO_CALL = p.BOARD_INFO[p.Kind.PIMU]
    INFO = ("Pimu.3", "Pimu.v0.7.2p6")

    def __init__(self, world: World, number: int) -> None:
        super().__init__(world, number)
        self._frozen = world.pimu_status()

    def kind_of(self, call: int, data: bytes) -> str:
        if call == p.PIMU_TRIGGER and p.parse_pimu_trigger(data) & p.RUNSTOP_ON:
            return "safe"
        return "config" if call in (p.PIMU_CONFIG, p.PIMU_TRIGGER, p.MOTOR_SYNC) else "other"

    def do(self, call: int, data: bytes) -> bytes:
        match call:
            case p.PIMU_STATUS:
                return p.pack_pimu_status(self._status(), 6)
            case p.PIMU_CONFIG:
                self.world.stops_at_runstop = p.stops_at_runstop(data)
            case p.PIMU_TRIGGER:
                bits = p.parse_pimu_trigger(data)
                _check_bits(bits, PIMU_TRIGGERS)
                self.world.trigger_pimu(bits)
                return data
            case p.MOTOR_SYNC:
                self.world.sync()
                return struct.pack("<h", self.world.syncs & 0x7FFF)
            case p.PIMU_STATUS_AUX:
                return b"\0\0"
        return b""

    def _status(self) -> p.PimuStatus:
        """Return the status of the board. A board with the fault "stuck" repeats its last status."""
        if self.fault is not Fault.STUCK:
            self._frozen = self.world.pimu_status()
        return self._frozen


class WaccDecoder(BoardDecoder):
    CALLS = WACC_CALLS
    INFO_CALL = p.BOARD_INFO[p.Kind.WACC]
    INFO = ("Wacc.3", "Wacc.v0.7.2p3")

    def __init__(self, world: World) -> None:
        super().__init__(world, WACC_NUMBER)
        self._scale = 1.0
        self._outputs = (0, 0)

    def kind_of(self, call: int, data: bytes) -> str:
        return "config" if call in (p.WACC_CONFIG, p.WACC_COMMAND) else "other"

    def do(self, call: int, data: bytes) -> bytes:
        match call:
            case p.WACC_CONFIG:
                self._scale = p.acceleration_scale(data)
            case p.WACC_COMMAND:
                self._outputs = p.wacc_outputs(data)
            case p.WACC_STATUS:
                gravity = (0.0, 0.0, 9.81 * self._scale)
                return p.pack_wacc_status(gravity, round(self.world.time_s * 1e6), self._outputs)
        return b""


def _check_bits(bits: int, modelled: int) -> None:
    """Raise ``MalformedFrame`` if a trigger has a bit that is not modelled."""
    if bits & ~modelled:
        raise MalformedFrame(f"the trigger {bits & ~modelled} is not modelled")


class ChainDecoder:
    """Decodes and answers the frames to a chain of servos, by the robot's clock. ``driven`` contains the ids of
    all servos except the gripper's."""

    def __init__(self, world: World, bus: DynamixelBus, driven: frozenset[int]) -> None:
        self._world = world
        self._bus = bus
        self._driven = driven
        self._decoder = dxl.Decoder()

    def frames(self, data: bytes, bits_per_s: int | None) -> Iterator[ReceivedFrame]:
        for packet in self._decoder.feed(data):
            yield ReceivedFrame(dxl.classify(packet), partial(self._act, packet, bits_per_s))

    def _act(self, packet: dxl.Packet, bits_per_s: int | None) -> Exchange:
        kind = dxl.classify(packet)
        replies = self._bus.handle(packet, bits_per_s)
        self._note(kind, packet)
        safe_state = self._world.safe_state if kind == "safe" else None
        return Exchange(kind, dxl.frame(*packet), replies, safe_state)

    def _note(self, kind: str, packet: dxl.Packet) -> None:
        """Store which servos got a goal by a packet of the host, and which were stopped by it."""
        ids = frozenset({packet.id})
        if packet.id == dxl.BROADCAST:
            ids = frozenset(dxl.rows_of(packet)[1]) if packet.code == dxl.SYNC_WRITE else self._driven
        if kind == "setpoint":
            self._world.dirty_servos |= ids & self._driven
        elif kind == "safe":
            self._world.dirty_servos -= ids
