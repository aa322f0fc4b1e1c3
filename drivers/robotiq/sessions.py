"""Serve one client of the twin: Modbus TCP, Modbus RTU, or the text port of Robotiq's URCap (``urcap``)."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import NamedTuple

from pymodbus.constants import ExcCodes
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadInputRegistersRequest,
    ReadInputRegistersResponse,
    ReadWriteMultipleRegistersRequest,
    ReadWriteMultipleRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterRequest,
    WriteSingleRegisterResponse,
)

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports import modbus, modbus_rtu
from strands_actors.drivers.common.twin import ClientGone, Exchange, Fault, Reply

from . import protocol as p
from .unit import RobotiqTwin


class _Wish(NamedTuple):
    """The accesses of a request: first a write of some output registers, then a read of some registers."""

    write_at: int = 0  # register address
    values: tuple[int, ...] = ()
    read_at: int = 0
    size: int = 0


def _wish_of(request: ModbusPDU) -> _Wish | None:
    """Return the accesses of a request; None for a function that a gripper does not have."""
    match request:
        case WriteMultipleRegistersRequest() | WriteSingleRegisterRequest():
            return _Wish(request.address, tuple(request.registers))
        case ReadWriteMultipleRegistersRequest():
            values = tuple(request.write_registers)
            return _Wish(request.write_address, values, request.read_address, request.read_count)
        case ReadHoldingRegistersRequest():  # and its subclass for input registers
            return _Wish(read_at=request.address, size=request.count)
    return None


def _fits(first: int, count: int) -> bool:
    return first >= 0 and count > 0 and first + count <= p.REGISTERS


class ModbusSession(ABC):
    """One master. It may use functions 3, 4, 6, 16 and 23, as in the manual."""

    def __init__(self, twin: RobotiqTwin) -> None:
        self._twin = twin

    @abstractmethod
    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]: ...

    @abstractmethod
    def encoded(self, response: ModbusPDU) -> bytes: ...

    def exchange(self, request: ModbusPDU, frame: bytes) -> Exchange:
        kind = self._kind(request)
        return Exchange(kind, frame, self._replies(request, kind), "hold" if kind == "safe" else None)

    def _kind(self, request: ModbusPDU) -> str:
        """Return the kind of a request, in the terms of the wire log."""
        wish = _wish_of(request)
        if wish is None or request.dev_id != self._twin.unit:
            return "read" if wish is not None and not wish.values else "other"
        if not wish.values:
            return "read"
        first = wish.write_at - p.OUTPUT
        return self._twin.kind_of(first, wish.values) if _fits(first, len(wish.values)) else "other"

    def _replies(self, request: ModbusPDU, kind: str) -> list[Reply]:
        if self._twin.fault is Fault.OFF:
            return []
        response = self.answer(request)
        if response is None:
            return []
        response.dev_id, response.transaction_id = request.dev_id, request.transaction_id
        reply = self._twin.faults.apply(Reply(0.0, self.encoded(response), None, kind))
        return [] if reply is None else [reply]

    def answer(self, request: ModbusPDU) -> ModbusPDU | None:
        twin = self._twin
        twin.gripper.hear()
        wish = _wish_of(request)
        if wish is None:
            return ExceptionResponse(request.function_code, ExcCodes.ILLEGAL_FUNCTION)
        first = wish.write_at - p.OUTPUT
        read = self._read(wish) if wish.size or not wish.values else []
        if read is None or (wish.values and not _fits(first, len(wish.values))):
            return ExceptionResponse(request.function_code, ExcCodes.ILLEGAL_ADDRESS)
        if wish.values:
            twin.write(first, wish.values)
            read = self._read(wish) or []  # the registers after the write
        match request:
            case WriteMultipleRegistersRequest():
                return WriteMultipleRegistersResponse(address=request.address, count=len(wish.values))
            case WriteSingleRegisterRequest():
                return WriteSingleRegisterResponse(address=request.address, registers=list(wish.values))
            case ReadWriteMultipleRegistersRequest():
                return ReadWriteMultipleRegistersResponse(registers=read)
            case ReadInputRegistersRequest():  # pymodbus makes it a subclass of the next one
                return ReadInputRegistersResponse(registers=read)
        return ReadHoldingRegistersResponse(registers=read)

    def _read(self, wish: _Wish) -> list[int] | None:
        """Return the requested registers; None if they do not exist."""
        twin = self._twin
        for base, block in ((p.INPUT, twin.status().registers()), (p.OUTPUT, twin.output())):
            first = wish.read_at - base
            if _fits(first, wish.size):
                return block[first : first + wish.size]
        return None


class TcpSession(ModbusSession):
    def __init__(self, twin: RobotiqTwin) -> None:
        super().__init__(twin)
        self._decoder = modbus.Decoder(requests=True)

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        try:
            for request, frame in self._decoder.feed(data):
                yield self.exchange(request, frame)
        except MalformedFrame:
            raise ClientGone from None  # A server closes the connection when it cannot decode it.

    def encoded(self, response: ModbusPDU) -> bytes:
        return modbus.encode(response)

    def answer(self, request: ModbusPDU) -> ModbusPDU | None:
        if request.dev_id != self._twin.unit:
            return ExceptionResponse(request.function_code, ExcCodes.GATEWAY_NO_RESPONSE)
        return super().answer(request)


PAUSE_S = 0.05
"""A silence of this length ends an incomplete frame. The norm has 3.5 characters, but an adapter delivers a frame
in pieces that are further apart."""


class RtuSession(ModbusSession):
    """One master on a serial line, or behind a gateway that forwards its bytes. Requests for another unit, or at
    another speed, are not answered."""

    def __init__(
        self, twin: RobotiqTwin, baud: int | None = None, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        """Take the speed of the line as ``baud``; None for a transport without a speed."""
        super().__init__(twin)
        self._baud = baud
        self._now_s = now_s
        self._heard_s = now_s()
        self._decoder = modbus_rtu.RtuDecoder(requests=True)

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        if self._baud is not None and bits_per_s not in (None, self._baud):
            yield Exchange("garbled", data, [])
            return
        now_s = self._now_s()
        if now_s - self._heard_s > PAUSE_S:
            self._decoder.clear()
        self._heard_s = now_s
        for frame in self._decoder.feed(data):
            request = modbus_rtu.request_of(frame)
            if request is not None:
                yield self.exchange(request, frame.bytes)

    def encoded(self, response: ModbusPDU) -> bytes:
        return modbus_rtu.encode(response)

    def answer(self, request: ModbusPDU) -> ModbusPDU | None:
        return super().answer(request) if request.dev_id == self._twin.unit else None
