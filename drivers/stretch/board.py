"""One board on its serial port: who it is, what it is asked, and frames that nobody waits for."""

from __future__ import annotations

from collections.abc import Callable

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.half_duplex import HalfDuplexBus
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.serial_port import BytePort
from strands_actors.kernel.clock import Clock

from . import frames as f
from . import protocol as p
from .config import BAUD

OpenPort = Callable[[str, int], BytePort]

ANSWER_S = 0.25
"""Within which a board answers when it is opened."""

MOST_FRAMES = 18
"""Of a reply: 1024 bytes."""


class Board:
    """Everything raises ``WireDown`` once the port is gone. Who waits for an answer has the line to
    itself until then; ``send``, ``send_first`` and ``tell`` wait for nobody."""

    def __init__(self, name: str, port: BytePort, clock: Clock) -> None:
        self.name = name
        self.port = port
        self.bus: HalfDuplexBus[f.Frame] = HalfDuplexBus(port, f.Decoder(), clock, BAUD, overhead=f.OVERHEAD)
        self.info = p.BoardInfo("", "", "", (0, 0), 0)
        self._line = trio.Lock()
        self._is_owed = False  # an answer to ``tell`` that can be told from others

    def close(self) -> None:
        self.port.close()

    def send(self, call: bytes) -> None:
        """A short call that nobody waits for: its acknowledgement is thrown away."""
        self.bus.send(f.push(call))

    def send_first(self, call: bytes) -> None:
        """The same on a port of which nothing is known: what waits to leave is thrown away, and a
        frame that this, or the death of its writer, has cut in two ends before ours begins."""
        self.port.discard_output()
        self.bus.send(f.RESYNC + f.push(call))

    def tell(self, call: bytes) -> None:
        """As ``send``, for a call that ``was_told`` is asked about."""
        self._is_owed = not (self.bus.quiet or self._line.locked())
        if not self._is_owed:
            self.send(call)
            return
        self.port.discard_input()  # acknowledgements that nobody has waited for
        self.bus.send_owed(f.push(call), {f.PUSH_ACK: 0})

    async def was_told(self) -> bool:
        """Return whether the last ``tell`` was acknowledged; False, too, where that cannot be told
        from another answer that is on its way."""
        if not self._is_owed:
            return False
        async with self._line:
            await self.bus.hear_out()
        return not self.bus.quiet

    async def identify(self, kind: p.Kind) -> None:
        """Ask who it is, over the transport that every firmware speaks. Raise ``WireDown`` for
        another board, and for firmware that is not known."""
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
        """Do a call of any length; whether it was acknowledged, frame by frame."""
        last: f.Frame | None = None
        async with self._line:
            for frame in f.pushes(call):
                replies = await self.bus.transact(frame, {f.PUSH_ACK: 0}, ANSWER_S, wait=True)
                last = replies.get(f.PUSH_ACK)
                if last is None:
                    return False
        return _acknowledges(last, call)

    async def change(self, call: bytes, permit: Permit) -> bool:
        """Do a short call beside whoever reads and commands the board; whether it was acknowledged.
        It keeps the line for one answer at most, so that nobody waits longer for it than for a
        silent board. In the quiet time raise ``Quiet``."""
        async with self._line:
            permit.check()
            replies = await self.bus.transact(f.push(call), {f.PUSH_ACK: 0})
        # it may be that of a setpoint, which nobody waits for
        return _acknowledges(replies.get(f.PUSH_ACK), call)

    async def must(self, call: bytes, what: str) -> None:
        """Raise ``WireDown`` when a call is not acknowledged."""
        if not await self.command(call):
            raise WireDown(f"{self.name} does not take {what}. Check its cable and power")

    async def ask(self, call: int, *, wait: bool = False) -> bytes | None:
        """Return the reply without its number; None: it did not come whole. In the quiet time raise
        ``Quiet``, or sit it out."""
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
        """Return what it reports; None: nothing, or nonsense."""
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
