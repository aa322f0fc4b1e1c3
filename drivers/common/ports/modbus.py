"""Modbus TCP: a codec, which is pure, and a client that never mixes up replies.

The codec uses the framer and PDU classes of pymodbus. The clients of pymodbus are not used: if the peer is silent,
they block for seconds, repeat requests, and reconnect without notice.

A reply carries the transaction id of its request, so it is assigned correctly, however late it is. A reply without
a request ends the connection.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence

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
from strands_actors.kernel.clock import Clock

from ..codecs.malformed import MalformedFrame
from .exchange import Exchange, numbers
from .tcp_port import ByteStream

# Without this handler pymodbus prints each malformed frame to stderr.
logging.getLogger("pymodbus").addHandler(logging.NullHandler())

SILENT_S = 0.5
"""A peer with an open request that has sent nothing for so long counts as gone."""

MAX_OPEN = 4096
"""Most unanswered requests, while others are answered. There are far more transaction ids."""

_HEADER = 7
_MAX_LENGTH = 254
_LAST_ID = 0xFFFF


class NotUnderstood(WireDown):
    """The peer has sent something that was not requested, so its replies cannot be used any more. A command to it
    may still take effect."""


class Decoder:
    """Find PDUs (Modbus messages without the header of their frame) in a stream of bytes. Each PDU has its
    ``dev_id`` and ``transaction_id``."""

    def __init__(self, *, requests: bool) -> None:
        """Make a decoder: with ``requests`` for the requests of a client, otherwise for the replies of a server."""
        self._framer = FramerSocket(DecodePDU(is_server=requests))
        self._pending = b""

    @property
    def has_part(self) -> bool:
        """True if the beginning of a frame has arrived, but not all of it."""
        return bool(self._pending)

    def feed(self, data: bytes) -> Iterator[tuple[ModbusPDU, bytes]]:
        """Yield each complete PDU with its frame.

        Raises:
            MalformedFrame: The bytes are no frame. Frames have no start mark, so the next one cannot be found, and
                the connection must be closed.
        """
        self._pending += data
        while len(self._pending) > _HEADER:
            protocol, length = (int.from_bytes(self._pending[offset : offset + 2], "big") for offset in (2, 4))
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
    """Return the frame of a PDU. Its ``dev_id`` and ``transaction_id`` must be set."""
    frame: bytes = FramerSocket(DecodePDU(is_server=False)).buildFrame(pdu)
    return frame


def exception_words(code: int) -> str:
    """Return a text such as ``illegal address (exception 2)``."""
    try:
        name = ExcCodes(code).name.lower().replace("_", " ")
    except ValueError:
        name = "unknown"
    return f"{name} (exception {code})"


class ModbusClient:
    """Send requests to one Modbus unit on one connection. Only one task may use the client. Several requests may be
    unanswered at once.

    Args:
        stream: The connection. The client closes it.
        unit: The Modbus unit id.
        name: The name of the peer for messages.
        clock: The clock of the process.
    """

    def __init__(self, stream: ByteStream, unit: int, name: str, clock: Clock) -> None:
        self._stream = stream
        self._unit = unit
        self._name = name
        self._clock = clock
        self._decoder = Decoder(requests=False)
        self._numbers = numbers(_LAST_ID)  # the transaction ids
        # The answer to a read request is its registers.
        self._exchange: Exchange[int, ModbusPDU, list[int]] = Exchange(MAX_OPEN)

    def write_registers(self, address: int, values: Sequence[int]) -> None:
        """Send a write request now. If the peer refuses it, the next call of ``answer`` raises. Raise
        ``WireDown``."""
        self._ask(WriteMultipleRegistersRequest(address=address, registers=list(values)), awaited=False)

    def read_registers(self, address: int, count: int) -> int:
        """Send a read request now. Return its number, for ``answer`` or ``forget``. Raise ``WireDown``."""
        return self._ask(ReadInputRegistersRequest(address=address, count=count), awaited=True)

    async def answer(self, number: int, within_s: float) -> list[int] | None:
        """Wait for the reply to a read request. Return the registers; None if they do not come in time.

        Args:
            number: The result of ``read_registers``.
            within_s: Longest wait.

        Raises:
            WireDown: The peer has refused a request, or has sent nothing for ``SILENT_S`` while a request was
                unanswered.
            NotUnderstood: The peer has sent something that was not requested.
        """
        return await self.first_answer((number,), within_s)

    async def first_answer(self, numbers: Sequence[int], within_s: float) -> list[int] | None:
        """Wait until one of several read requests is answered, and return its registers. Return None or raise as
        ``answer`` does."""
        await self._exchange.wait(within_s, self._receive, *numbers)
        for number in numbers:
            if (registers := self._exchange.pop(number)) is not None:
                return registers
        silent_s = self._exchange.silent_s(self._clock.now_ns())
        if silent_s > SILENT_S:
            raise WireDown(
                f"{self._name}: no answer for {silent_s * 1e3:.0f} ms. Check the device's power, then reconnect"
            )
        return None

    @property
    def has_partial_answer(self) -> bool:
        """True if a part of a reply has arrived, and the rest is missing."""
        return self._decoder.has_part

    def forget(self, number: int) -> None:
        """Ignore the reply to a read request, which may still arrive."""
        self._exchange.forget(number)

    def close(self) -> None:
        self._stream.close()

    def _ask(self, request: ModbusPDU, awaited: bool) -> int:
        if self._exchange.unanswered >= MAX_OPEN:
            raise WireDown(f"{self._name}: {MAX_OPEN} requests are unanswered. Check the device, then reconnect")
        number = next(self._numbers)
        request.dev_id, request.transaction_id = self._unit, number
        self._stream.write(encode(request))
        self._exchange.sent(number, request, self._clock.now_ns(), awaited=awaited)
        return number

    async def _receive(self) -> None:
        data = await self._stream.read()
        try:
            for reply, _ in self._decoder.feed(data):
                self._exchange.received(self._clock.now_ns())
                number = reply.transaction_id
                self._exchange.take(number, self._registers(self._exchange.request(number), reply))
        except MalformedFrame as malformed:
            raise NotUnderstood(f"{self._name}: answers with no Modbus frame ({malformed}). Reconnect") from None

    def _registers(self, request: ModbusPDU | None, reply: ModbusPDU) -> list[int]:
        if request is None or reply.dev_id != self._unit:
            raise NotUnderstood(f"{self._name}: answers what was not asked. Reconnect")
        if isinstance(reply, ExceptionResponse):
            raise WireDown(
                f"{self._name}: refuses a request: {exception_words(reply.exception_code)}. "
                "Check unit_id= and the device's power"
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
