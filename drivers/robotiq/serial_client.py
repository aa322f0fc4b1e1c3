"""Access a gripper by Modbus RTU, on a serial line (RS-485) that both ends share.

There is one request at a time, because a reply has no number. A write waits for an answer that is on its way, as on
every half-duplex bus. A write is answered, too. The next request first receives that answer, and raises an error
if the gripper refused the write.
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
"""Parameter bytes of the answer to a read: a byte count, and the registers."""
WRITTEN_BYTES = 4
"""Parameter bytes of the answer to a write: the address and the count."""

QUIET_S = 0.03
"""Pause after a missing answer. It is longer than the gripper may be late [assumed: it answers within 10 ms]."""
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
        self._waiting_since_ns: int | None = None  # time of the first request without an answer
        self._hears_part = False
        self.descriptors = (port.fileno(),)

    async def clear_way(self) -> None:
        await self._bus.discard_pending()

    def write(self, command: Command) -> None:
        request = WriteMultipleRegistersRequest(
            address=protocol.OUTPUT, registers=command.registers(), dev_id=self._unit
        )
        self._bus.send_owed(modbus_rtu.encode(request), {self._unit: WRITTEN_BYTES})

    async def status(self, within_s: float, permit: Permit | None = None) -> Status | None:
        with trio.move_on_after(within_s):
            while True:
                if permit is not None:
                    permit.check()
                status = await self._asked()
                if status is not None:
                    return status
                await trio.sleep(AGAIN_S)
        return None

    async def soonest(self, number: int | None, within_s: float) -> Status | None:
        """Request the status. An open answer arrives first, since the line has one request at a time."""
        return await self.status(within_s)

    def ask(self) -> int:
        return 0  # Nothing is sent yet: an answer that no caller awaits would block the line.

    async def answer(self, number: int, within_s: float) -> Status | None:
        status = None
        with trio.move_on_after(within_s):
            status = await self._asked()
        now_ns = self._clock.now_ns()
        if status is None and self._waiting_since_ns is not None:
            silent_s = (now_ns - self._waiting_since_ns) / NS
            if silent_s > SILENT_S:
                raise WireDown(
                    f"{self._name}: no answer for {silent_s * 1e3:.0f} ms. Check its power, then reconnect"
                )
        return status

    def forget(self, number: int) -> None:
        """Do nothing: a request is sent only when its answer is awaited."""

    @property
    def has_partial_answer(self) -> bool:
        return self._hears_part

    @property
    def sent(self) -> int:
        """The number of frames that the port has taken."""
        return self._bus.sent

    async def hung_up(self) -> None:
        """Wait until the adapter is gone."""
        await self._port.hung_up()

    def close(self) -> None:
        self._port.close()

    async def _asked(self) -> Status | None:
        """Send one request. Return None if no answer came, or if it is too early to ask again."""
        bus = self._bus
        await bus.discard_pending()
        self._tell(bus.refusals.get(self._unit))
        if self._waiting_since_ns is None:
            self._waiting_since_ns = self._clock.now_ns()
        try:
            replies = await bus.transact(self._question, {self._unit: ANSWER_BYTES})
        except Quiet:
            await trio.lowlevel.checkpoint()
            return None
        self._tell(bus.refusals.get(self._unit))
        self._hears_part = not replies and bus.stray_bytes > 0
        if self._unit not in replies:
            return None
        self._waiting_since_ns = None
        words = replies[self._unit].params[1:]
        return Status.from_registers([int.from_bytes(words[at : at + 2], "big") for at in range(0, len(words), 2)])

    def _tell(self, refusal: str | None) -> None:
        if refusal is not None:
            self._bus.refusals = {}
            raise WireDown(f"{self._name}: refuses: {refusal}. Check unit_id= and its power")
