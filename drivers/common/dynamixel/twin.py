"""Simulate the servos of a Dynamixel bus: their control tables, and their joints in MuJoCo."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Self

from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin import Exchange, Reply
from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.common.twin.servo_bus import ServoBus

from . import protocol as p
from . import table as t
from .servo import Servo

INSTRUCTIONS: Modelled[int] = Modelled(
    "instructions to the servos",
    {
        p.PING: "returns model and firmware",
        p.READ: "returns registers",
        p.WRITE: "writes registers; the errors of the protocol for read-only ones and values out of range",
        p.REG_WRITE: "keeps a write until the next action",
        p.ACTION: "carries out the kept write",
        p.FACTORY_RESET: "restores the values at delivery",
        p.REBOOT: "restarts the servo",
        p.CLEAR: "clears the turns of the encoder",
        p.SYNC_READ: "returns the same registers of several servos",
        p.SYNC_WRITE: "writes the same registers of several servos",
        p.FAST_SYNC_READ: "returns the same registers of several servos in one frame",
        p.BULK_READ: "returns registers of several servos",
        p.BULK_WRITE: "writes registers of several servos",
        p.FAST_BULK_READ: "returns registers of several servos in one frame",
    },
    "the error of the protocol for an unknown instruction (0x02); silence if it was sent to all servos",
)


class DynamixelBus(ServoBus[Servo, p.Packet]):
    def __init__(self, plant: Plant, servos: Sequence[Servo], now_s: Callable[[], float] = time.monotonic) -> None:
        self._frames = p.Decoder()
        super().__init__(plant, servos, self._frames, now_s)

    @classmethod
    def of_table(cls, table: Mapping[str, Any], now_s: Callable[[], float] = time.monotonic) -> Self:
        """Return a simulated bus with the joints of one robot's table in ``robots.toml``."""
        numbers = {name: number for number, name in t.MODEL_NUMBERS.items()}
        plant = Plant.from_table(table)
        servos = [
            Servo(plant, index, joint["id"], numbers[joint["model"]], joint["mode"], float(joint["voltage_v"]))
            for index, joint in enumerate(table["joints"])
        ]
        return cls(plant, servos, now_s)

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        yield from super().receive(data, bits_per_s)
        for servo_id, frame in self._frames.take_damaged():
            replies = [_status(servo, p.CRC_ERROR) for servo in self.hearing(bits_per_s).get(servo_id, ())]
            yield Exchange("other", frame, self.with_faults(replies))

    def exchange(self, packet: p.Packet, replies: Sequence[Reply]) -> Exchange:
        kind = p.classify(packet)
        safe_state = p.safe_state(packet, [servo.id for servo in self.servos]) if kind == "safe" else None
        return Exchange(kind, p.frame(*packet), replies, safe_state)

    def step_to(self, now_s: float) -> None:
        """Advance the simulation to ``now_s``. If the time of a bus watchdog ends earlier, its servo is stopped at
        that earlier time, before the next request is handled."""
        while (due := min(self.servos, key=lambda servo: servo.trips_at_s)).trips_at_s <= now_s:
            super().step_to(due.trips_at_s)
            if due.energised:
                due.trip()
        super().step_to(now_s)

    def answer(self, packet: p.Packet, hearing: Mapping[int, Sequence[Servo]]) -> Iterable[Reply | None]:
        parts = _split_request(packet, hearing)
        if packet.code not in INSTRUCTIONS:
            errors = [_refuse(each.servo) for each in parts]
            return errors if packet.id != p.BROADCAST else ()
        for servo in {each.servo for each in parts}:
            servo.hear(self.now_s())
        match packet.code:
            case p.SYNC_READ | p.BULK_READ:
                return [_read(*each[:3]) for each in parts]
            case p.FAST_SYNC_READ:
                size = _word(packet.params, 2)
                return _fast_read([(servo_id, size) for servo_id in packet.params[4:]], parts)
            case p.FAST_BULK_READ:
                return _fast_read([(servo_id, size) for servo_id, _, size in _bulk_read_rows(packet.params)], parts)
            case p.SYNC_WRITE | p.BULK_WRITE:
                for servo, address, _, data in parts:
                    servo.write(address, data)
                return ()
            case _:
                replies = [_answer(each.servo, packet) for each in parts]
                return replies if packet.code == p.PING or packet.id != p.BROADCAST else ()


class RequestPart(NamedTuple):
    """The part of a request that concerns one servo: read ``size`` bytes at ``address``, or write ``data``
    there."""

    servo: Servo
    address: int
    size: int
    data: bytes


def _split_request(packet: p.Packet, hearing: Mapping[int, Sequence[Servo]]) -> list[RequestPart]:
    """Split a request into its parts for the servos, in the order of the request. Ids without a servo are left
    out."""
    params = packet.params
    rows: Iterable[tuple[int, int, int, bytes]]
    match packet.code:
        case p.SYNC_READ | p.FAST_SYNC_READ:
            address, size = _word(params, 0), _word(params, 2)
            rows = ((servo_id, address, size, b"") for servo_id in params[4:])
        case p.SYNC_WRITE:
            address, blocks = p.rows_of(packet)
            rows = ((servo_id, address, len(block), block) for servo_id, block in blocks.items())
        case p.BULK_READ | p.FAST_BULK_READ:
            rows = ((*row, b"") for row in _bulk_read_rows(params))
        case p.BULK_WRITE:
            rows = _bulk_rows(params)
        case _:
            ids = sorted(hearing) if packet.id == p.BROADCAST else [packet.id]
            rows = ((servo_id, 0, 0, b"") for servo_id in ids)
    return [
        RequestPart(servo, address, size, data)
        for servo_id, address, size, data in rows
        for servo in hearing.get(servo_id, ())
    ]


def _bulk_read_rows(params: bytes) -> list[tuple[int, int, int]]:
    """Return id, address and size of each servo's part of a bulk read."""
    starts = range(0, len(params) - 4, 5)
    return [(params[offset], _word(params, offset + 1), _word(params, offset + 3)) for offset in starts]


def _bulk_rows(params: bytes) -> Iterator[tuple[int, int, int, bytes]]:
    offset = 0
    while offset + 5 <= len(params):
        size = _word(params, offset + 3)
        yield params[offset], _word(params, offset + 1), size, params[offset + 5 : offset + 5 + size]
        offset += 5 + size


def _word(data: bytes, offset: int) -> int:
    return int.from_bytes(data[offset : offset + 2], "little")


def _status(servo: Servo, error: int = 0, params: bytes = b"", kind: str = "read") -> Reply:
    return Reply(servo.return_delay_s, p.status(servo.id, error | servo.alert, params), servo.id, kind)


def _read(servo: Servo, address: int, size: int) -> Reply | None:
    if servo.get(t.STATUS_LEVEL) == 0:
        return None
    return _status(servo, *servo.read(address, size))


def _fast_read(rows: Sequence[tuple[int, int]], parts: Sequence[RequestPart]) -> list[Reply]:
    """Return the single frame in which the servos answer a fast read. The frame ends at the first missing servo.

    Args:
        rows: Id and data size of each requested servo.
        parts: The requests to the servos that exist.
    """
    answers = []
    for (servo_id, size), (servo, address, _, _) in zip(rows, parts, strict=False):
        if servo.id != servo_id:
            break
        error, block = servo.read(address, size)
        answers.append((servo_id, error | servo.alert, block.ljust(size, b"\0")))
    if not answers:
        return []
    first = parts[0].servo
    return [Reply(first.return_delay_s, p.fast_status(answers, [size for _, size in rows]), first.id)]


def _refuse(servo: Servo) -> Reply | None:
    """Return the servo's error for an instruction that it does not know; None if it does not reply to writes."""
    return _status(servo, p.INSTRUCTION_ERROR, kind="other") if servo.get(t.STATUS_LEVEL) >= 2 else None


def _answer(servo: Servo, packet: p.Packet) -> Reply | None:
    """Carry out a request to one servo. Return its reply; None if the servo does not reply."""
    params = packet.params
    # Prepare the servo's reply before the request changes anything, so that it has the old id and the old delay.
    reply = _status(servo, kind=p.classify(packet))
    error = 0
    match packet.code:
        case p.PING:
            model = bytes(servo.table[t.MODEL.address : t.MODEL.address + 2])
            return _status(servo, 0, model + bytes((servo.get(t.FIRMWARE),)))
        case p.READ if len(params) == 4:
            return _read(servo, _word(params, 0), _word(params, 2))
        case p.WRITE if len(params) > 2:
            error = servo.write(_word(params, 0), params[2:])
        case p.REG_WRITE if len(params) > 2:
            servo.keep(params)
        case p.ACTION:
            error = servo.act()
        case p.REBOOT:
            servo.power_cycle()
        case p.FACTORY_RESET:
            error = servo.reset(params[0]) if len(params) == 1 else p.LENGTH_ERROR
        case p.CLEAR:
            error = servo.clear_turns(params)
        case _:
            error = p.INSTRUCTION_ERROR
    if servo.get(t.STATUS_LEVEL) < 2:
        return None
    return reply._replace(data=p.status(reply.unit or 0, error | servo.alert))
