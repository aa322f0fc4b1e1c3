"""Answer one Modbus client of a simulated gripper, by TCP or RTU.

The module ``urcap`` does the same for clients of the text port of Robotiq's URCap.
"""

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
from strands_actors.drivers.common.twin.modelled import Modelled

from . import protocol as p
from .unit import RobotiqTwin

FUNCTIONS: Modelled[int] = Modelled(
    "Modbus functions",
    {
        3: "returns registers of status or command",
        4: "returns registers of status or command",
        6: "writes one register of the command",
        16: "writes registers of the command",
        23: "writes registers of the command, then returns registers",
    },
    "exception 1, illegal function; 2, illegal address, for registers that the gripper has not",
)


class RegisterAccess(NamedTuple):
    """The registers that a Modbus request accesses. First it writes registers, then it reads registers."""

    write_address: int = 0  # Address of the first register to write.
    values: tuple[int, ...] = ()
    read_address: int = 0
    size: int = 0


def _access_of(request: ModbusPDU) -> RegisterAccess | None:
    """Return the registers that a request writes and reads. None if a gripper does not support its function."""
    match request:
        case WriteMultipleRegistersRequest() | WriteSingleRegisterRequest():
            return RegisterAccess(request.address, tuple(request.registers))
        case ReadWriteMultipleRegistersRequest():
            values = tuple(request.write_registers)
            return RegisterAccess(request.write_address, values, request.read_address, request.read_count)
        case ReadHoldingRegistersRequest():  # In pymodbus this includes requests for input registers.
            return RegisterAccess(read_address=request.address, size=request.count)
    return None


def _fits(first: int, count: int) -> bool:
    return first >= 0 and count > 0 and first + count <= p.REGISTERS


class ModbusSession(ABC):
    """The answers to one Modbus master. As in the manual, it may use the functions 3, 4, 6, 16 and 23."""

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
        """Return the kind of a request as the log of received messages (wire log) names it: ``setpoint``,
        ``safe``, ``read``, and so on."""
        access = _access_of(request)
        if access is None or request.dev_id != self._twin.unit:
            return "read" if access is not None and not access.values else "other"
        if not access.values:
            return "read"
        first = access.write_address - p.OUTPUT
        return self._twin.kind_of(first, access.values) if _fits(first, len(access.values)) else "other"

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
        twin.gripper.note_request()
        access = _access_of(request)
        if access is None or request.function_code not in FUNCTIONS:
            return ExceptionResponse(request.function_code, ExcCodes.ILLEGAL_FUNCTION)
        first = access.write_address - p.OUTPUT
        read = self._read(access) if access.size or not access.values else []
        if read is None or (access.values and not _fits(first, len(access.values))):
            return ExceptionResponse(request.function_code, ExcCodes.ILLEGAL_ADDRESS)
        if access.values:
            twin.write(first, access.values)
            read = self._read(access) or []  # Function 23 answers with the registers after its write.
        match request:
            case WriteMultipleRegistersRequest():
                return WriteMultipleRegistersResponse(address=request.address, count=len(access.values))
            case WriteSingleRegisterRequest():
                return WriteSingleRegisterResponse(address=request.address, registers=list(access.values))
            case ReadWriteMultipleRegistersRequest():
                return ReadWriteMultipleRegistersResponse(registers=read)
            # This case must be before the request for holding registers, which is its base class in pymodbus.
            case ReadInputRegistersRequest():
                return ReadInputRegistersResponse(registers=read)
        return ReadHoldingRegistersResponse(registers=read)

    def _read(self, access: RegisterAccess) -> list[int] | None:
        """Return the values of the registers to read. None if the gripper has no such registers."""
        twin = self._twin
        for base, block in ((p.INPUT, twin.status().registers()), (p.OUTPUT, twin.output())):
            first = access.read_address - base
            if _fits(first, access.size):
                return block[first : first + access.size]
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
            raise ClientGone from None  # A server closes the connection after bytes that it cannot decode.

    def encoded(self, response: ModbusPDU) -> bytes:
        return modbus.encode(response)

    def answer(self, request: ModbusPDU) -> ModbusPDU | None:
        if request.dev_id != self._twin.unit:
            return ExceptionResponse(request.function_code, ExcCodes.GATEWAY_NO_RESPONSE)
        return super().answer(request)


PAUSE_S = 0.05
"""If no byte arrives for this time, an incomplete frame is discarded. The Modbus standard requires 3.5 characters,
but a serial adapter may deliver a frame in pieces with longer pauses."""


class RtuSession(ModbusSession):
    """The answers to one Modbus RTU master, on a serial line or through a gateway that forwards the bytes.

    Requests for another unit, or at another baud rate, are not answered.
    """

    def __init__(
        self, twin: RobotiqTwin, baud: int | None = None, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        """Answer for the gripper of ``twin``. ``baud`` is the baud rate of the line, or None if there is no
        line."""
        super().__init__(twin)
        self._baud = baud
        self._now_s = now_s
        self._last_received_s = now_s()
        self._decoder = modbus_rtu.RtuDecoder(requests=True)

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        if self._baud is not None and bits_per_s not in (None, self._baud):
            yield Exchange("garbled", data, [])
            return
        now_s = self._now_s()
        if now_s - self._last_received_s > PAUSE_S:
            self._decoder.clear()
        self._last_received_s = now_s
        for frame in self._decoder.feed(data):
            request = modbus_rtu.request_of(frame)
            if request is not None:
                yield self.exchange(request, frame.bytes)

    def encoded(self, response: ModbusPDU) -> bytes:
        return modbus_rtu.encode(response)

    def answer(self, request: ModbusPDU) -> ModbusPDU | None:
        return super().answer(request) if request.dev_id == self._twin.unit else None
