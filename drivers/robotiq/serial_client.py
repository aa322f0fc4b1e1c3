"""Access a gripper by Modbus RTU, on a half-duplex serial line (RS-485).

Only one request at a time is possible, because a reply has no number. A write first waits for an answer that is
still to arrive. The gripper also answers a write. This answer is received before the next request is sent. If it
says that the gripper has refused the write, the next request raises ``WireDown``.
"""

from __future__ import annotations

import trio
from pymodbus.pdu.register_message import ReadInputRegistersRequest, WriteMultipleRegistersRequest

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.ports import modbus_rtu
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus, Quiet
from strands_actors.drivers.common.ports.modbus import SILENT_S
from strands_actors.drivers.common.ports.modbus_rtu import RtuDecoder, RtuFrame
from strands_actors.drivers.common.ports.serial_port import BytePort
from strands_actors.kernel.clock import NS, Clock

from . import protocol
from .client import GripperClient
from .config import RobotiqConfig
from .protocol import Command, Status

ANSWER_BYTES = 1 + 2 * protocol.REGISTERS
"""Size of the answer to a read in bytes, without address, function and checksum: a byte count and the registers."""
WRITTEN_BYTES = 4
"""Size of the answer to a write in bytes, without address, function and checksum: the first register and the
count."""

QUIET_S = 0.03
"""Pause on the line after a missing answer, so that a late answer does not collide with the next request [assumed:
a gripper answers within 10 ms]."""
AGAIN_S = 0.005


class SerialGripper(GripperClient):
    def __init__(self, port: BytePort, config: RobotiqConfig, clock: Clock) -> None:
        self._name = f"{config.robot} at {config.port}"
        self._unit = config.unit_id
        self._port = port
        self._clock = clock
        self._bus: HalfDuplexBus[RtuFrame] = HalfDuplexBus(
            port,
            RtuDecoder(requests=False),
            clock,
            config.baud,
            overhead=modbus_rtu.OVERHEAD,
            quiet_s=QUIET_S,
        )
        request = ReadInputRegistersRequest(address=protocol.INPUT, count=protocol.REGISTERS, dev_id=self._unit)
        self._question = modbus_rtu.encode(request)
        self._waiting_since_ns: int | None = None  # Time of the first request since the last answer.
        self._has_partial_answer = False
        self.descriptors = (port.fileno(),)

    async def wait_until_ready(self) -> None:
        await self._bus.discard_pending()

    def write(self, command: Command) -> None:
        request = WriteMultipleRegistersRequest(
            address=protocol.OUTPUT, registers=command.registers(), dev_id=self._unit
        )
        self._bus.send_unawaited(modbus_rtu.encode(request), {self._unit: WRITTEN_BYTES})

    async def status(self, within_s: float, permit: Permit | None = None) -> Status | None:
        with trio.move_on_after(within_s):
            while True:
                if permit is not None:
                    permit.check()
                status = await self._request_status()
                if status is not None:
                    return status
                await trio.sleep(AGAIN_S)
        return None

    async def soonest(self, number: int | None, within_s: float) -> Status | None:
        """Request the status. An answer to an earlier request is received first, because the line is
        half-duplex."""
        return await self.status(within_s)

    def ask(self) -> int:
        return (
            0  # Send nothing yet. An answer that is not read would block the line, so ``answer`` sends the request.
        )

    async def answer(self, number: int, within_s: float) -> Status | None:
        status = None
        with trio.move_on_after(within_s):
            status = await self._request_status()
        now_ns = self._clock.now_ns()
        if status is None and self._waiting_since_ns is not None:
            silent_s = (now_ns - self._waiting_since_ns) / NS
            if silent_s > SILENT_S:
                raise WireDown(
                    f"{self._name}: the gripper did not answer for {silent_s * 1e3:.0f} ms. "
                    "Check its power, then reconnect"
                )
        return status

    def forget(self, number: int) -> None:
        """Do nothing. A request is sent only in ``answer``, which also receives its answer."""

    @property
    def has_partial_answer(self) -> bool:
        return self._has_partial_answer

    @property
    def sent(self) -> int:
        """The number of frames that were sent on the serial port."""
        return self._bus.sent

    async def hung_up(self) -> None:
        """Wait until the serial adapter is unplugged."""
        await self._port.hung_up()

    def close(self) -> None:
        self._port.close()

    async def _request_status(self) -> Status | None:
        """Request the status once and wait for the answer.

        Return None if no answer came, or if the pause after a missing answer is not over.
        """
        bus = self._bus
        await bus.discard_pending()
        self._raise_refusal(bus.refusals.get(self._unit))
        if self._waiting_since_ns is None:
            self._waiting_since_ns = self._clock.now_ns()
        try:
            replies = await bus.transact(self._question, {self._unit: ANSWER_BYTES})
        except Quiet:
            await trio.lowlevel.checkpoint()
            return None
        self._raise_refusal(bus.refusals.get(self._unit))
        self._has_partial_answer = not replies and bus.stray_bytes > 0
        if self._unit not in replies:
            return None
        self._waiting_since_ns = None
        words = replies[self._unit].params[1:]
        return Status.from_registers([int.from_bytes(words[i : i + 2], "big") for i in range(0, len(words), 2)])

    def _raise_refusal(self, refusal: str | None) -> None:
        if refusal is not None:
            self._bus.refusals = {}
            raise WireDown(f"{self._name}: the gripper refuses a request ({refusal}). Check unit_id= and its power")
