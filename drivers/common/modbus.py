"""Modbus TCP: frames and their decoder, pure, and a client that is never out of step.

The codec is pymodbus's own framer and PDU classes. Its clients are not used: on a silent peer they
block for seconds, repeat by themselves and reconnect behind one's back.

A reply belongs to the question whose transaction id it bears, however late it is; one that belongs
to no question ends the connection. So no reply can ever be taken for the next one's.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence

import trio
from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadInputRegistersRequest,
    ReadInputRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
)

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.clock import NS, Clock

from .malformed import MalformedFrame
from .tcp_port import ByteStream

logging.getLogger("pymodbus").addHandler(logging.NullHandler())  # else a bad frame is printed on stderr

SILENT_S = 0.5
"""A peer that was asked and has said nothing for so long is gone."""

MAX_OPEN = 4096
"""Questions without an answer, while others are answered; far fewer than there are transaction
ids."""

_HEADER = 7
_MAX_LENGTH = 254
_LAST_ID = 0xFFFF


class NotUnderstood(WireDown):
    """The peer is there and answers, but not with what was asked for: what it says is of no more
    use. What it is told may be."""


class Decoder:
    """A stream of bytes to PDUs, whose ``dev_id`` and ``transaction_id`` are set."""

    def __init__(self, *, requests: bool) -> None:
        """``requests``: the stream of a client, otherwise of a server."""
        self._framer = FramerSocket(DecodePDU(is_server=requests))
        self._pending = b""

    @property
    def has_part(self) -> bool:
        """Return whether a frame has begun to come."""
        return bool(self._pending)

    def feed(self, data: bytes) -> Iterator[tuple[ModbusPDU, bytes]]:
        """Yield PDUs with their frames. Raise ``MalformedFrame``: a stream has no start marks, so
        the connection is of no more use."""
        self._pending += data
        while len(self._pending) > _HEADER:
            protocol, length = (int.from_bytes(self._pending[at : at + 2], "big") for at in (2, 4))
            if protocol != 0 or not 2 <= length <= _MAX_LENGTH:
                raise MalformedFrame(f"protocol {protocol}, length {length}")
            used, unit, number, body = self._framer.decode(self._pending[: _HEADER - 1 + length])
            if not used:
                return
            frame, self._pending = self._pending[:used], self._pending[used:]
            pdu = self._framer.decoder.decode(body)
            if pdu is None:
                raise MalformedFrame(f"function {body[0]}")
            pdu.dev_id, pdu.transaction_id = unit, number
            yield pdu, frame


def encode(pdu: ModbusPDU) -> bytes:
    """Return the frame of a PDU whose ``dev_id`` and ``transaction_id`` are set."""
    frame: bytes = FramerSocket(DecodePDU(is_server=False)).buildFrame(pdu)
    return frame


def exception_words(code: int) -> str:
    """``illegal address (exception 2)``."""
    try:
        name = ExcCodes(code).name.lower().replace("_", " ")
    except ValueError:
        name = "unknown"
    return f"{name} (exception {code})"


class ModbusClient:
    """Questions to one unit on one connection. Calls never overlap; questions may."""

    def __init__(self, stream: ByteStream, unit: int, name: str, clock: Clock) -> None:
        self._stream = stream
        self._unit = unit
        self._name = name
        self._clock = clock
        self._decoder = Decoder(requests=False)
        self._number = 0
        self._open: dict[int, ModbusPDU] = {}  # questions whose answer has not come
        self._answers: dict[int, list[int] | None] = {}  # by question that somebody waits for
        self._waiting_since_ns = 0  # when it was last heard, or since when it was asked
        self._asked_ns = 0

    def write_registers(self, address: int, values: Sequence[int]) -> None:
        """Send at once. That it was refused is told by the next ``answer``. Raise ``WireDown``."""
        self._ask(WriteMultipleRegistersRequest(address=address, registers=list(values)))

    def read_registers(self, address: int, count: int) -> int:
        """Send at once; a number to give to ``answer`` or to ``forget``. Raise ``WireDown``."""
        number = self._ask(ReadInputRegistersRequest(address=address, count=count))
        self._answers[number] = None
        return number

    async def answer(self, number: int, within_s: float) -> list[int] | None:
        """Return the registers that were asked for, or None: not yet. Raise ``WireDown`` when the
        peer refuses anything, was asked and has said nothing for ``SILENT_S``, or speaks
        nonsense."""
        return await self.first_answer((number,), within_s)

    async def first_answer(self, numbers: Sequence[int], within_s: float) -> list[int] | None:
        """As ``answer``, to whichever of these questions is answered first."""
        with trio.move_on_after(within_s):
            while all(self._answers[number] is None for number in numbers):
                self._take(await self._stream.read())
        for number in numbers:
            if self._answers[number] is not None:
                return self._answers.pop(number)
        silent_s = (self._clock.now_ns() - self._waiting_since_ns) / NS
        if silent_s > SILENT_S:
            raise WireDown(f"{self._name}: no answer for {silent_s * 1e3:.0f} ms. Check its power, then reconnect")
        return None

    @property
    def hears_part(self) -> bool:
        """Return whether the peer has begun an answer, and not ended it."""
        return self._decoder.has_part

    def forget(self, number: int) -> None:
        """The answer is of no more interest; it may still come."""
        self._answers.pop(number, None)

    def close(self) -> None:
        self._stream.close()

    def _ask(self, request: ModbusPDU) -> int:
        if len(self._open) >= MAX_OPEN:
            raise WireDown(f"{self._name}: {MAX_OPEN} questions without an answer. Check it, then reconnect")
        self._number = self._number % _LAST_ID + 1
        request.dev_id, request.transaction_id = self._unit, self._number
        now_ns = self._clock.now_ns()
        if not self._open or now_ns - self._asked_ns > SILENT_S * NS:
            self._waiting_since_ns = now_ns  # nobody was waiting, or nobody asked
        self._asked_ns = now_ns
        self._stream.write(encode(request))
        self._open[self._number] = request
        return self._number

    def _take(self, data: bytes) -> None:
        try:
            for reply, _ in self._decoder.feed(data):
                self._waiting_since_ns = self._clock.now_ns()
                request = self._open.pop(reply.transaction_id, None)
                registers = self._registers(request, reply)
                if reply.transaction_id in self._answers:
                    self._answers[reply.transaction_id] = registers
        except MalformedFrame as malformed:
            raise NotUnderstood(f"{self._name}: answers with no Modbus frame ({malformed}). Reconnect") from None

    def _registers(self, request: ModbusPDU | None, reply: ModbusPDU) -> list[int]:
        if request is None or reply.dev_id != self._unit:
            raise NotUnderstood(f"{self._name}: answers what was not asked. Reconnect")
        if isinstance(reply, ExceptionResponse):
            raise WireDown(
                f"{self._name}: refuses: {exception_words(reply.exception_code)}. Check unit_id= and its power"
            )
        match request, reply:
            case ReadInputRegistersRequest(), ReadInputRegistersResponse():
                registers = list(reply.registers)
                if len(registers) == request.count:
                    return registers
            case WriteMultipleRegistersRequest(), WriteMultipleRegistersResponse():
                if (reply.address, reply.count) == (request.address, len(request.registers)):
                    return []
        raise NotUnderstood(f"{self._name}: its answer does not fit the question. Reconnect")
