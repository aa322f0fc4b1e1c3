"""Access a gripper by Modbus TCP."""

from __future__ import annotations

import trio

from strands_actors.contract.wire import Permit
from strands_actors.drivers.common.ports.modbus import ModbusClient

from . import protocol
from .client import GripperClient
from .protocol import Command, Status

ASK_AGAIN_S = 0.1


class TcpGripper(GripperClient):
    def __init__(self, client: ModbusClient) -> None:
        self._client = client

    async def wait_until_ready(self) -> None:
        """Do nothing: by TCP a command can be sent while an answer is still to arrive."""

    def write(self, command: Command) -> None:
        self._client.write_registers(protocol.OUTPUT, command.registers())

    async def status(self, within_s: float, permit: Permit | None = None) -> Status | None:
        """Request the status every ``ASK_AGAIN_S`` until an answer arrives. Return None after ``within_s``
        seconds."""
        end_s = trio.current_time() + within_s
        while (remaining_s := end_s - trio.current_time()) > 0:
            if permit is not None:
                permit.check()
            number = self.ask()
            status = await self.answer(number, min(remaining_s, ASK_AGAIN_S))
            if status is not None:
                return status
            self.forget(number)
        return None

    async def soonest(self, number: int | None, within_s: float) -> Status | None:
        """Send another status request, and return the answer that arrives first: to it or to request ``number``.

        So a lost request causes no delay. Return None after ``within_s`` seconds.
        """
        numbers = [self.ask()] if number is None else [self.ask(), number]
        try:
            registers = await self._client.first_answer(numbers, within_s)
        finally:
            for request_number in numbers:
                self.forget(request_number)
        return None if registers is None else Status.from_registers(registers)

    def ask(self) -> int:
        return self._client.read_registers(protocol.INPUT, protocol.REGISTERS)

    async def answer(self, number: int, within_s: float) -> Status | None:
        registers = await self._client.answer(number, within_s)
        return None if registers is None else Status.from_registers(registers)

    @property
    def has_partial_answer(self) -> bool:
        return self._client.has_partial_answer

    def forget(self, number: int) -> None:
        self._client.forget(number)

    def close(self) -> None:
        self._client.close()
