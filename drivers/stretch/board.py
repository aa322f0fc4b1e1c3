"""One board on its serial port: identification, calls with an answer, and frames without one."""

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
    """A board. All methods raise ``WireDown`` once the port is gone.

    A call with an answer has the line for itself until the answer comes. ``send``, ``send_first`` and ``tell``
    write without waiting for it.
    """

    def __init__(self, name: str, port: BytePort, clock: Clock) -> None:
        self.name = name
        self.port = port
        self.bus: HalfDuplexBus[f.Frame] = HalfDuplexBus(port, f.Decoder(), clock, BAUD, overhead=f.OVERHEAD)
        self.info = p.BoardInfo("", "", "", (0, 0), 0)
        self._line = trio.Lock()
        self._is_owed = False  # True while a distinguishable answer to ``tell`` is pending

    def close(self) -> None:
        self.port.close()

    def send(self, call: bytes) -> None:
        """Send a short call. Its acknowledgement is dropped."""
        self.bus.send(f.push(call))

    def send_first(self, call: bytes) -> None:
        """Send a short call on a port in an unknown state. Waiting output is dropped. A frame that was cut by this,
        or by the death of its writer, ends before our frame begins."""
        self.port.discard_output()
        self.bus.send(f.RESYNC + f.push(call))

    def tell(self, call: bytes) -> None:
        """Send a short call. ``was_acknowledged`` waits for its acknowledgement."""
        self._is_owed = not (self.bus.quiet or self._line.locked())
        if not self._is_owed:
            self.send(call)
            return
        self.port.discard_input()  # old acknowledgements of ``send``
        self.bus.send_owed(f.push(call), {f.PUSH_ACK: 0})

    async def was_acknowledged(self) -> bool:
        """Return True if the last ``tell`` was acknowledged. Return False, too, if its answer cannot be
        distinguished from another pending one."""
        if not self._is_owed:
            return False
        async with self._line:
            await self.bus.discard_pending()
        return not self.bus.quiet

    async def identify(self, kind: p.Kind) -> None:
        """Identify the board, over the transport that every firmware speaks. Raise ``WireDown`` for another board,
        and for unknown firmware."""
        reply = await self._v0(p.BOARD_INFO[kind])
        try:
            info = p.parse_board_info(reply)
        except MalformedFrame as malformed:
            raise WireDown(f"{self.name} says that {malformed}. Check its firmware") from None
        if info.kind != kind:
            raise WireDown(f"{self.name} is a {info.kind} board, must be a {kind}. Check the udev rules")
        if info.version < p.OLDEST_V1 or info.protocol not in p.PROTOCOLS[kind]:
            known = p.PROTOCOLS[kind]
            raise WireDown(
                f"{self.name} has firmware {info.firmware}. It must be v0.4 or newer, with protocol "
                f"p{known[0]} to p{known[-1]}"
            )
        self.info = info

    async def command(self, call: bytes) -> bool:
        """Send a call of any length. Return True if each of its frames was acknowledged."""
        last: f.Frame | None = None
        async with self._line:
            for frame in f.pushes(call):
                replies = await self.bus.transact(frame, {f.PUSH_ACK: 0}, ANSWER_S, wait=True)
                last = replies.get(f.PUSH_ACK)
                if last is None:
                    return False
        return _acknowledges(last, call)

    async def change(self, call: bytes, permit: Permit) -> bool:
        """Send a short call while other tasks read and command the board. Return True if it was acknowledged.

        It holds the line for one answer at most, so that no task waits longer for it than for a silent board.

        Raises:
            Quiet: The line is in its quiet time.
        """
        async with self._line:
            permit.check()
            replies = await self.bus.transact(f.push(call), {f.PUSH_ACK: 0})
        # It may be the acknowledgement of a setpoint, which no task waits for.
        return _acknowledges(replies.get(f.PUSH_ACK), call)

    async def must(self, call: bytes, what: str) -> None:
        """Send a call. Raise ``WireDown`` if it is not acknowledged."""
        if not await self.command(call):
            raise WireDown(f"{self.name} does not take {what}. Check its cable and power")

    async def ask(self, call: int, *, wait: bool = False) -> bytes | None:
        """Return the reply to a call without its number; None if it did not arrive completely.

        Args:
            call: Number of the call.
            wait: Wait for the end of a quiet time. Otherwise raise ``Quiet`` in it.
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
        """Return the status of a stepper; None without a readable answer."""
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
            raise WireDown(f"{self.name} answers another question. Power-cycle the robot")
        return reply[1:]

    async def _v0_step(self, request: bytes, code: int) -> f.Frame:
        replies = await self.bus.transact(request, {code: 0}, ANSWER_S, wait=True)
        if code not in replies:
            raise WireDown(f"{self.name} does not say who it is. Check its cable and power")
        return replies[code]


def _acknowledges(frame: f.Frame | None, call: bytes) -> bool:
    return frame is not None and frame.data[:1] == bytes((call[0] + 1,))
