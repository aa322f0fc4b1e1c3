"""One board on its serial port: identification, requests that wait for an answer, and frames that do not."""

from __future__ import annotations

from collections.abc import Callable

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus
from strands_actors.drivers.common.ports.serial_port import BytePort
from strands_actors.kernel.clock import Clock

from . import frames as f
from . import protocol as p
from .config import BAUD

OpenPort = Callable[[str, int], BytePort]

ANSWER_S = 0.25
"""Longest time for an answer while the board is opened."""

MOST_FRAMES = 18
"""Largest number of frames in a reply: 1024 bytes."""


class Board:
    """One board of the robot. All methods raise ``WireDown`` once the port is gone.

    In this protocol a request is named a call. A method that waits for an answer has the line for itself until
    the answer comes. ``send``, ``send_first`` and ``tell`` write at once, even while another answer is awaited.
    """

    def __init__(self, name: str, port: BytePort, clock: Clock) -> None:
        self.name = name
        self.port = port
        self.bus: HalfDuplexBus[f.Frame] = HalfDuplexBus(port, f.Decoder(), clock, BAUD, overhead=f.OVERHEAD)
        self.info = p.BoardInfo("", "", "", (0, 0), 0)
        self._line = trio.Lock()
        # True while the acknowledgement of the last ``tell`` is pending and cannot be mistaken for another.
        self._ack_is_pending = False

    def close(self) -> None:
        self.port.close()

    def send(self, call: bytes) -> None:
        """Send a short call (a request to the board). Its acknowledgement is not awaited."""
        self.bus.send(f.push(call))

    def send_first(self, call: bytes) -> None:
        """Send a short call (a request to the board) on a port in an unknown state. Unsent output is dropped. A
        frame that was thereby cut, or that a dead process left unfinished, is ended before our frame begins."""
        self.port.discard_output()
        self.bus.send(f.RESYNC + f.push(call))

    def tell(self, call: bytes) -> None:
        """Send a short call (a request to the board) without waiting. ``was_acknowledged`` can then wait for its
        acknowledgement."""
        self._ack_is_pending = not (self.bus.quiet or self._line.locked())
        if not self._ack_is_pending:
            self.send(call)
            return
        # Drop old acknowledgements of ``send``.
        self.port.discard_input()
        self.bus.send_unawaited(f.push(call), {f.PUSH_ACK: 0})

    async def was_acknowledged(self) -> bool:
        """Return True if the last ``tell`` was acknowledged. Return False also if its acknowledgement cannot be
        told from that of another pending call."""
        if not self._ack_is_pending:
            return False
        async with self._line:
            await self.bus.discard_pending()
        return not self.bus.quiet

    async def identify(self, kind: p.Kind) -> None:
        """Ask the board for its kind and firmware, over transport V0, which every firmware speaks. Raise
        ``WireDown`` for another kind of board, and for unknown firmware."""
        reply = await self._v0(p.BOARD_INFO[kind])
        try:
            info = p.parse_board_info(reply)
        except MalformedFrame as malformed:
            raise WireDown(
                f"{self.name} identifies itself with an invalid message: {malformed}. Check its firmware"
            ) from None
        if info.kind != kind:
            raise WireDown(f"{self.name} is a {info.kind} board, must be a {kind}. Check the udev rules")
        if info.version < p.OLDEST_V1 or info.protocol not in p.PROTOCOLS[kind]:
            protocols = p.PROTOCOLS[kind]
            raise WireDown(
                f"{self.name} has firmware {info.firmware}. It must be v0.4 or newer, with protocol "
                f"p{protocols[0]} to p{protocols[-1]}"
            )
        self.info = info

    async def command(self, call: bytes) -> bool:
        """Send a call (a request to the board) of any length. Return True if each of its frames was
        acknowledged."""
        last: f.Frame | None = None
        async with self._line:
            for frame in f.pushes(call):
                replies = await self.bus.transact(frame, {f.PUSH_ACK: 0}, ANSWER_S, wait=True)
                last = replies.get(f.PUSH_ACK)
                if last is None:
                    return False
        return _acknowledges(last, call)

    async def change(self, call: bytes, permit: Permit) -> bool:
        """Send a short call (a request to the board) while other tasks read and command the board. Return True if
        it was acknowledged.

        The line is occupied for one answer at most, so no other task waits longer than for a silent board.

        Raises:
            Quiet: The line must stay quiet for a while after a missing reply.
        """
        async with self._line:
            permit.check()
            replies = await self.bus.transact(f.push(call), {f.PUSH_ACK: 0})
        # This may also be the acknowledgement of a setpoint. No task waits for those.
        return _acknowledges(replies.get(f.PUSH_ACK), call)

    async def must(self, call: bytes, subject: str) -> None:
        """Send a call (a request to the board). Raise ``WireDown`` if it is not acknowledged."""
        if not await self.command(call):
            raise WireDown(f"{self.name} did not acknowledge {subject}. Check its cable and power")

    async def ask(self, call: int, *, wait: bool = False) -> bytes | None:
        """Return the reply to a call (a request to the board), without the number at its start; None if the reply
        did not arrive completely.

        Args:
            call: Number of the call.
            wait: True waits for the end of the quiet time after a missing reply. False raises ``Quiet`` during
                that time.
        """
        reply, request = b"", f.pull(call)
        async with self._line:
            for _ in range(MOST_FRAMES):
                replies = await self.bus.transact(request, {f.PULL_LAST: 0}, wait=wait)
                part = replies.get(f.PULL_LAST)
                if part is None:
                    return None
                reply += part.data
                if part.code == f.PULL_LAST:
                    return reply[1:] if reply[:1] == bytes((call + 1,)) else None
                request = f.pull_next(call)
        return None

    async def stepper_status(self, *, wait: bool = False) -> p.StepperStatus | None:
        """Request the status of a stepper board; None if the answer is missing or unreadable."""
        data = await self.ask(p.STATUS, wait=wait)
        try:
            return None if data is None else p.parse_stepper_status(data)
        except MalformedFrame:
            return None

    async def pimu_status(self, *, wait: bool = False) -> p.PimuStatus | None:
        data = await self.ask(p.PIMU_STATUS, wait=wait)
        try:
            return None if data is None else p.parse_pimu_status(data)
        except MalformedFrame:
            return None

    async def _v0(self, call: int) -> bytes:
        self.bus.send(f.RESYNC)
        await self._v0_step(f.frame(f.V0_START), f.V0_STARTED)
        await self._v0_step(f.frame(f.V0_SEND_LAST, bytes((call,))), f.V0_SENT_LAST)
        reply = b""
        for _ in range(MOST_FRAMES):
            part = await self._v0_step(f.frame(f.V0_GET), f.V0_GOT_LAST)
            reply += part.data
            if part.code == f.V0_GOT_LAST:
                break
        if reply[:1] != bytes((call + 1,)):
            raise WireDown(f"{self.name} sent the answer to another request. Power-cycle the robot")
        return reply[1:]

    async def _v0_step(self, request: bytes, code: int) -> f.Frame:
        replies = await self.bus.transact(request, {code: 0}, ANSWER_S, wait=True)
        if code not in replies:
            raise WireDown(f"{self.name} does not identify itself. Check its cable and power")
        return replies[code]


def _acknowledges(frame: f.Frame | None, call: bytes) -> bool:
    return frame is not None and frame.data[:1] == bytes((call[0] + 1,))
