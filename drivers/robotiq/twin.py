"""The robot's end of the wire: a Modbus TCP server with a gripper behind it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Unpack

import msgspec
from pymodbus.constants import ExcCodes
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadInputRegistersRequest,
    ReadInputRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
)

from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.modbus import Decoder, encode
from strands_actors.drivers.common.twin import (
    ClientGone,
    Exchange,
    Fault,
    Faults,
    Reply,
    Start,
    TcpServer,
    WireLog,
    answering,
    known_options,
    run_server,
)

from . import protocol as p
from .body import GripperBody
from .mechanism import Gripper, Setup
from .robots import TABLES, UNIT

OPTIONS = {
    "host": "address to serve at (default: one of its own in 127.0.0.0/8)",
    "port": "TCP port (default: any free one)",
    "unit_id": "Modbus unit (default 9)",
    "object_mm": "width of a rigid object between the fingers (default 0: none)",
    "activation_s": "seconds an activation takes (default 1.5)",
    "activated": "whether it is activated from the start (default false)",
    "echo_s": "seconds until a command counts and is repeated (default 0)",
    "gflt": "number of a fault it has from the start; below 10 it has it for good (default 0: none)",
}


class RobotiqTwin:
    """One gripper, for all clients."""

    def __init__(
        self,
        setup: Setup,
        unit: int,
        table: Mapping[str, Any],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """``table``: of ``robots.toml``, for its looks."""
        self.gripper = Gripper(setup, now_s)
        self.unit = unit
        self.body = GripperBody(self.gripper, table)
        self.faults = Faults()
        self._felt = p.Status()
        self._output = p.RESET.registers()

    @property
    def fault(self) -> Fault:
        return self.faults.of(None)

    def set_fault(self, fault: Fault, unit: int | None = None) -> None:
        """``unit``: of no meaning here, there is one speaker."""
        if Fault.OFF in (fault, self.fault):
            self.power_cycle()
        self.gripper.hear()
        self._felt = self.gripper.status()
        self.gripper.stuck = fault is Fault.STUCK
        self.faults.set(fault)

    def power_cycle(self) -> None:
        self.gripper.power_cycle()
        self._output = p.RESET.registers()

    def status(self) -> p.Status:
        """What is said, which with a fault is not what is."""
        if self.fault is Fault.STUCK:
            return self._felt
        status = self.gripper.status()
        if self.fault is Fault.WRONG:
            return msgspec.structs.replace(status, request=p.TOP - status.request, position=p.TOP - status.position)
        return status

    def output(self) -> list[int]:
        return list(self._output)

    def write(self, first: int, registers: list[int]) -> None:
        """Some of the output registers, from the ``first``-th on."""
        self._output[first : first + len(registers)] = registers
        self.gripper.write(p.Command.from_registers(self._output))

    def kind(self, request: ModbusPDU) -> str:
        """A request in the words of the wire log."""
        if not isinstance(request, WriteMultipleRegistersRequest):
            return "read" if isinstance(request, ReadHoldingRegistersRequest) else "other"
        first = request.address - p.OUTPUT
        if request.dev_id != self.unit or not _fits(first, len(request.registers)):
            return "other"
        output = self.output()
        output[first : first + len(request.registers)] = request.registers
        return p.classify(p.Command.from_registers(output), self.gripper.asked_to_be_active)


class ModbusSession:
    """What hears one client."""

    def __init__(self, twin: RobotiqTwin) -> None:
        self._twin = twin
        self._decoder = Decoder(requests=True)

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        try:
            for request, frame in self._decoder.feed(data):
                kind = self._twin.kind(request)
                yield Exchange(kind, frame, self._replies(request, kind), "hold" if kind == "safe" else None)
        except MalformedFrame:
            raise ClientGone from None  # as a server does with what it cannot follow

    def _replies(self, request: ModbusPDU, kind: str) -> list[Reply]:
        if self._twin.fault is Fault.OFF:
            return []
        response = self._answer(request)
        response.dev_id, response.transaction_id = request.dev_id, request.transaction_id
        reply = self._twin.faults.apply(Reply(0.0, encode(response), None, kind))
        return [] if reply is None else [reply]

    def _answer(self, request: ModbusPDU) -> ModbusPDU:
        twin = self._twin
        if request.dev_id != twin.unit:
            return ExceptionResponse(request.function_code, ExcCodes.GATEWAY_NO_RESPONSE)
        twin.gripper.hear()
        match request:
            case WriteMultipleRegistersRequest() if _fits(request.address - p.OUTPUT, len(request.registers)):
                twin.write(request.address - p.OUTPUT, list(request.registers))
                return WriteMultipleRegistersResponse(address=request.address, count=len(request.registers))
            case ReadHoldingRegistersRequest():
                for base, block in ((p.INPUT, twin.status().registers()), (p.OUTPUT, twin.output())):
                    first = request.address - base
                    if _fits(first, request.count):
                        response = _RESPONSES[type(request)]
                        return response(registers=block[first : first + request.count])
            case WriteMultipleRegistersRequest():
                pass
            case _:
                return ExceptionResponse(request.function_code, ExcCodes.ILLEGAL_FUNCTION)
        return ExceptionResponse(request.function_code, ExcCodes.ILLEGAL_ADDRESS)


_RESPONSES = {
    ReadHoldingRegistersRequest: ReadHoldingRegistersResponse,
    ReadInputRegistersRequest: ReadInputRegistersResponse,  # a kind of the first to pymodbus
}


def _fits(first: int, count: int) -> bool:
    return first >= 0 and count > 0 and first + count <= p.REGISTERS


def twin_of(robot: str, now_s: Callable[[], float] = time.monotonic, **options: Any) -> RobotiqTwin:
    """The twin of a robot of ``robots.toml``; ``options`` without host and port."""
    table = TABLES.table(robot)
    unit = int(options.pop("unit_id", UNIT))
    return RobotiqTwin(Setup.from_table(table, **options), unit, table, now_s)


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Serve a robot of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    given = known_options(options, OPTIONS)
    host, port = given.pop("host", None), int(given.pop("port", 0))
    twin = twin_of(robot, **given)

    def build(wire_log: WireLog) -> TcpServer:
        return TcpServer(twin, {port: answering(lambda: ModbusSession(twin))}, wire_log, host)

    run_server(build, **start)
