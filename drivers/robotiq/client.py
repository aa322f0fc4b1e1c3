"""A gripper's registers over one connection, and how it is made to hold. Shared by the wire and by
the root's stop channel."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import trio

from strands_actors.contract.driver import MotorReport, Permit, WireDown
from strands_actors.drivers.common.modbus import ModbusClient
from strands_actors.drivers.common.tcp_port import ByteStream
from strands_actors.kernel.clock import Clock

from . import protocol
from .config import RobotiqConfig
from .protocol import Command, Status

OpenStream = Callable[[str, int], Awaitable[ByteStream]]

ASK_AGAIN_S = 0.1

ATTEMPTS = 3
CONFIRM_S = 0.25
"""Of each attempt: three, and a connection, fit into what a stop may take."""


class GripperClient:
    """One gripper on one connection: its registers as ``Command`` and ``Status``."""

    def __init__(self, client: ModbusClient) -> None:
        self._client = client

    def write(self, command: Command) -> None:
        """Send at once. Raise ``WireDown``."""
        self._client.write_registers(protocol.OUTPUT, command.registers())

    async def status(self, within_s: float, permit: Permit | None = None) -> Status | None:
        """Ask, and again every ``ASK_AGAIN_S``. None: no answer in time. ``permit`` is checked
        meanwhile. Raise ``WireDown``."""
        end_s = trio.current_time() + within_s
        while (left_s := end_s - trio.current_time()) > 0:
            if permit is not None:
                permit.check()
            number = self.ask()
            status = await self.answer(number, min(left_s, ASK_AGAIN_S))
            if status is not None:
                return status
            self.forget(number)
        return None

    def ask(self) -> int:
        return self._client.read_registers(protocol.INPUT, protocol.REGISTERS)

    async def answer(self, number: int, within_s: float) -> Status | None:
        registers = await self._client.answer(number, within_s)
        return None if registers is None else Status.from_registers(registers)

    @property
    def hears_part(self) -> bool:
        """Whether it has begun an answer, and not ended it."""
        return self._client.hears_part

    def forget(self, number: int) -> None:
        self._client.forget(number)

    def close(self) -> None:
        self._client.close()


async def open_gripper(config: RobotiqConfig, clock: Clock, open_stream: OpenStream) -> GripperClient:
    """Connect. Raise ``WireDown``."""
    try:
        host, port = config.address()
    except ValueError as error:
        raise WireDown(str(error)) from None
    stream = await open_stream(host, port)
    return GripperClient(ModbusClient(stream, config.unit_id, f"{config.robot} at {host}:{port}", clock))


async def hold(gripper: GripperClient, known: Status | None, config: RobotiqConfig) -> MotorReport:
    """Stop the fingers where they are, and prove it. Never raises. Without a ``known`` state the
    gripper is asked first: a hold would activate one that is not, and that moves its fingers."""
    written = heard = False
    detail = "silent"
    try:
        for _ in range(ATTEMPTS):
            known = known or await gripper.status(CONFIRM_S)
            if known is None:
                continue
            gripper.write(protocol.safe_command(known))
            written = True
            known = await gripper.status(CONFIRM_S)
            heard = heard or known is not None
            detail = "silent" if known is None else protocol.unsafe_words(known)
            if not detail:
                break
    except WireDown as error:
        detail = str(error)
    return config.report(written, heard, detail)
