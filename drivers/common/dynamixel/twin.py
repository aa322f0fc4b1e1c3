"""The robot's end of a Dynamixel bus: servos with their control tables, MuJoCo behind them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Self

from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin import Exchange, Reply
from strands_actors.drivers.common.twin.servo_bus import ServoBus

from . import protocol as p
from . import table as t
from .servo import Servo


class DynamixelBus(ServoBus[Servo, p.Packet]):
    def __init__(self, plant: Plant, servos: Sequence[Servo], now_s: Callable[[], float] = time.monotonic) -> None:
        self._frames = p.Decoder()
        super().__init__(plant, servos, self._frames, now_s)

    @classmethod
    def of_table(cls, table: Mapping[str, Any], now_s: Callable[[], float] = time.monotonic) -> Self:
        """Return the bus of the joints of one table of a ``robots.toml``."""
        numbers = {name: number for number, name in t.MODEL_NUMBERS.items()}
        plant = Plant.from_table(table)
        servos = [
            Servo(plant, at, joint["id"], numbers[joint["model"]], joint["mode"], float(joint["voltage_v"]))
            for at, joint in enumerate(table["joints"])
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
        """A bus watchdog trips in the silence before a request, not when the request ends it."""
        while (due := min(self.servos, key=lambda servo: servo.trips_at_s)).trips_at_s <= now_s:
            super().step_to(due.trips_at_s)
            if due.energised:
                due.trip()
        super().step_to(now_s)

    def answer(self, packet: p.Packet, hearing: Mapping[int, Sequence[Servo]]) -> Iterable[Reply | None]:
        asked = _asked(packet, hearing)
        for servo in {each.servo for each in asked}:
            servo.hear(self.now_s())
        match packet.code:
            case p.SYNC_READ | p.BULK_READ:
                return [_read(*each[:3]) for each in asked]
            case p.FAST_SYNC_READ:
                size = _word(packet.params, 2)
                return _fast_read([(servo_id, size) for servo_id in packet.params[4:]], asked)
            case p.FAST_BULK_READ:
                return _fast_read([(servo_id, size) for servo_id, _, size in _bulk_read_rows(packet.params)], asked)
            case p.SYNC_WRITE | p.BULK_WRITE:
                for servo, address, _, data in asked:
                    servo.write(address, data)
                return ()
            case _:
                replies = [_answer(each.servo, packet) for each in asked]
                return replies if packet.code == p.PING or packet.id != p.BROADCAST else ()


class Asked(NamedTuple):
    """A request to one servo: read ``size`` bytes at ``address``, or write ``data`` there."""

    servo: Servo
    address: int
    size: int
    data: bytes


def _asked(packet: p.Packet, hearing: Mapping[int, Sequence[Servo]]) -> list[Asked]:
    """In the order of the request; a servo that is not there leaves no gap."""
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
        Asked(servo, address, size, data)
        for servo_id, address, size, data in rows
        for servo in hearing.get(servo_id, ())
    ]


def _bulk_read_rows(params: bytes) -> list[tuple[int, int, int]]:
    """Id, address and size of each."""
    starts = range(0, len(params) - 4, 5)
    return [(params[at], _word(params, at + 1), _word(params, at + 3)) for at in starts]


def _bulk_rows(params: bytes) -> Iterator[tuple[int, int, int, bytes]]:
    at = 0
    while at + 5 <= len(params):
        size = _word(params, at + 3)
        yield params[at], _word(params, at + 1), size, params[at + 5 : at + 5 + size]
        at += 5 + size


def _word(data: bytes, at: int) -> int:
    return int.from_bytes(data[at : at + 2], "little")


def _status(servo: Servo, error: int = 0, params: bytes = b"", kind: str = "read") -> Reply:
    return Reply(servo.return_delay_s, p.status(servo.id, error | servo.alert, params), servo.id, kind)


def _read(servo: Servo, address: int, size: int) -> Reply | None:
    if servo.get(t.STATUS_LEVEL) == 0:
        return None
    return _status(servo, *servo.read(address, size))


def _fast_read(rows: Sequence[tuple[int, int]], asked: Sequence[Asked]) -> list[Reply]:
    """One frame of all; it ends at the first servo that is not there. ``rows``: ids and sizes."""
    answers = []
    for (servo_id, size), (servo, address, _, _) in zip(rows, asked, strict=False):
        if servo.id != servo_id:
            break
        error, block = servo.read(address, size)
        answers.append((servo_id, error | servo.alert, block.ljust(size, b"\0")))
    if not answers:
        return []
    first = asked[0].servo
    return [Reply(first.return_delay_s, p.fast_status(answers, [size for _, size in rows]), first.id)]


def _answer(servo: Servo, packet: p.Packet) -> Reply | None:
    """Carry out a request to one servo or to all. Return None if it gets no answer."""
    params = packet.params
    # The reply has the id and the delay from before the request.
    said = _status(servo, kind=p.classify(packet))
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
    return said._replace(data=p.status(said.unit or 0, error | servo.alert))
