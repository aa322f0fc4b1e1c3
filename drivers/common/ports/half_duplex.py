"""The master of a half-duplex servo bus. It sends one request at a time, and deals with late replies.

Frames on these buses have no sequence numbers. So a late reply looks like the reply to the next request of the same
id and length. After a missing reply, the master therefore sends no request for 0.1 s (the *quiet time*), and drops
everything that arrives. In a measurement one reply in ten was 60 ms late. Without the quiet time, 7 to 10 of 60
late replies were taken for the reply to the next request. With the quiet time, no late reply was
mistaken for another reply.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Generic, Protocol, TypeVar

import trio

from strands_actors.kernel.clock import NS, Clock

from .serial_port import BytePort

QUIET_S = 0.1
MARGIN_S = 0.025
"""Time added to the time of the bytes on the line: return delay, adapter (the timer of an FTDI chip alone
is set to 16 ms in the factory) and operating system. A stop may have to wait for one reply, so this is
half its bound."""

BACKOFF_S = (0.25, 0.5, 1.0, 2.0)
"""Wait before a silent motor is asked again. A request in vain costs the margin and the quiet time, 0.13 s.
At the shortest wait the other motors keep more than half their rate."""

MISSES_TOLERATED = 1

BUSY_S = 0.01
"""If this host looks for a reply so much later than planned, the host is late and not the robot. The
system may have dropped the reply meanwhile [assumed]."""

LISTEN_MAX_S = 1.0
"""Longest time of ``listen`` on a line that never falls silent."""


class Packet(Protocol):
    @property
    def id(self) -> int: ...
    @property
    def params(self) -> bytes: ...
    @property
    def failure(self) -> str:
        """Why the motor did not carry out the request, from its reply; empty if it did."""
        ...


PacketT = TypeVar("PacketT", bound=Packet)
PacketT_co = TypeVar("PacketT_co", bound=Packet, covariant=True)


class Decoder(Protocol[PacketT_co]):
    def feed(self, data: bytes) -> Iterable[PacketT_co]: ...
    def clear(self) -> None: ...


class Quiet(Exception):
    """No request can be sent during the quiet time after a missing reply. Try again later, or use the last known
    value."""


class HalfDuplexBus(Generic[PacketT]):
    """The master of one half-duplex bus.

    Args:
        port: The serial port.
        decoder: Finds packets in the received bytes.
        clock: The clock of the process.
        baud: Bits per second.
        overhead: Bytes of a reply without parameters (Feetech 6, Dynamixel 2.0: 11).
        margin_s: Time for a reply, in addition to the time of its bytes on the line.
        quiet_s: Time without requests after a missing reply.
    """

    def __init__(
        self,
        port: BytePort,
        decoder: Decoder[PacketT],
        clock: Clock,
        baud: int,
        *,
        overhead: int = 6,
        margin_s: float = MARGIN_S,
        quiet_s: float = QUIET_S,
    ) -> None:
        self.port = port
        self.clock = clock
        self._decoder = decoder
        self._byte_s = 10 / baud
        self._overhead = overhead
        self._margin_s = margin_s
        self._quiet_ns = round(quiet_s * NS)
        self._quiet_until_ns = 0
        # Replies that may still arrive for a cancelled request: number of parameter bytes, by servo id.
        self._pending: dict[int, int] = {}
        self._pending_end_s = 0.0
        self.stray_bytes = 0
        """Bytes received during the last request that belong to no expected reply."""
        self.refusals: dict[int, str] = {}
        """The error of each motor that answered the last request with one. Such a reply is dropped."""
        self.sent_ns = 0
        """When the last frame was sent."""
        self.sent = 0
        """Number of frames that the port has taken."""
        self.late_s = 0.0
        """How much later than planned this host gave up the last request. 0 if it was answered in time."""
        self.delay_s = 0.0
        """How much longer the last request took than its bytes need on the line."""

    @property
    def quiet(self) -> bool:
        return self.clock.now_ns() < self._quiet_until_ns

    @property
    def starved(self) -> bool:
        """True if this computer was late, so that the robot may not be the reason why the last reply was missed."""
        return self.late_s > BUSY_S

    def send(self, frame: bytes) -> None:
        """Send a frame that no motor replies to. It is sent at once, even in the quiet time."""
        self._write(frame)

    def send_unawaited(self, frame: bytes, expected: Mapping[int, int]) -> None:
        """Send a frame at once, although motors will reply to it. The next request waits for these replies first.
        Afterwards ``refusals`` has the errors that these replies report."""
        self._write(frame)
        answer_bytes = sum(expected.values()) + len(expected) * self._overhead
        line_s = (len(frame) + answer_bytes) * self._byte_s
        self._pending, self._pending_end_s = dict(expected), trio.current_time() + line_s + self._margin_s

    def _write(self, frame: bytes) -> None:
        self.port.write(frame)
        self.sent += 1
        self.sent_ns = self.clock.now_ns()

    async def transact(
        self,
        request: bytes,
        expected: Mapping[int, int],
        timeout_s: float | None = None,
        *,
        wait: bool = False,
    ) -> dict[int, PacketT]:
        """Send a request and return the replies by id. Missing replies and replies with an error are left out.

        Args:
            request: The frame.
            expected: Number of parameter bytes in each reply, by id. Everything else that arrives counts as stray.
            timeout_s: Longest time until the last reply. The default is the time of the bytes on the line plus the
                margin.
            wait: True waits until the quiet time ends, instead of raising ``Quiet``.

        Raises:
            Quiet: The quiet time after a missing reply has not ended.
        """
        await self._begin(wait)
        reply_bytes = sum(expected.values()) + len(expected) * self._overhead
        line_s = (len(request) + reply_bytes) * self._byte_s
        if timeout_s is None:
            timeout_s = line_s + self._margin_s
        replies: dict[int, PacketT] = {}
        self.stray_bytes = 0
        refusals = self.refusals = {}

        def take(data: bytes) -> None:
            self.stray_bytes += len(data)
            for packet in self._decoder.feed(data):
                if packet.id in replies or packet.id in refusals or packet.id not in expected:
                    continue
                if packet.failure:
                    refusals[packet.id] = packet.failure
                elif expected[packet.id] == len(packet.params):
                    replies[packet.id] = packet
                else:
                    continue
                self.stray_bytes -= self._overhead + len(packet.params)

        self._pending, self._pending_end_s = dict(expected), trio.current_time() + timeout_s
        try:
            self._write(request)
            began_s = trio.current_time()
            with trio.move_on_after(timeout_s) as window:
                while len(replies) + len(refusals) < len(expected):
                    take(await self.port.read())
            if window.cancelled_caught:
                self.late_s = trio.current_time() - window.deadline
                # Some bytes may have arrived in time, although this process was too late to read them.
                take(self.port.take())
            self.delay_s = trio.current_time() - began_s - line_s
            if len(replies) + len(refusals) < len(expected):
                self._quiet_until_ns = self.clock.now_ns() + self._quiet_ns
            self._pending = {}
        finally:
            # If this task is cancelled, its replies may still arrive. The next request waits for them first.
            self._pending = {i: size for i, size in self._pending.items() if i not in replies and i not in refusals}
        return replies

    async def discard_pending(self) -> None:
        """Wait for the replies to a cancelled request, and drop them, so that the next frame does not collide with
        them.

        If a reply does not come before the timeout of its request, a quiet time follows.
        """
        pending = self._pending
        if not pending:
            return
        self.refusals = {}
        with trio.move_on_at(self._pending_end_s):
            while pending:
                for packet in self._decoder.feed(await self.port.read()):
                    if packet.failure or pending.get(packet.id) == len(packet.params):
                        pending.pop(packet.id, None)
                        if packet.failure:
                            self.refusals[packet.id] = packet.failure
        if pending:
            self._quiet_until_ns = self.clock.now_ns() + self._quiet_ns
        self._pending = {}

    async def listen(self, request: bytes, first_s: float, silence_s: float) -> list[PacketT]:
        """Send a request and return every packet that arrives, from any motor.

        Args:
            request: The frame.
            first_s: Longest wait for the first byte.
            silence_s: Return when no byte has arrived for this time.
        """
        await self._begin(wait=True)
        packets: list[PacketT] = []
        self.stray_bytes = 0

        def take(data: bytes) -> None:
            self.stray_bytes += len(data)
            for packet in self._decoder.feed(data):
                packets.append(packet)
                self.stray_bytes -= self._overhead + len(packet.params)

        self._write(request)
        with trio.move_on_after(first_s) as window:
            end = trio.current_time() + LISTEN_MAX_S
            while True:
                take(await self.port.read())
                window.deadline = min(trio.current_time() + silence_s, end)
        self.late_s = trio.current_time() - window.deadline
        take(self.port.take())
        return packets

    async def _begin(self, wait: bool) -> None:
        await self.discard_pending()
        if self.quiet:
            if not wait:
                raise Quiet
            await self.clock.sleep_until_ns(self._quiet_until_ns)
        self.port.discard_input()
        self._decoder.clear()
        self.late_s = 0.0


class Health:
    """Choose the motors that the next request asks.

    A motor that missed two requests in a row is left out, so that one dead servo does not slow the others. It is
    asked again after a wait, which doubles each time. It is asked regularly again as soon as it answers.
    """

    def __init__(self, ids: Sequence[int]) -> None:
        self._ids = tuple(ids)
        self._misses = dict.fromkeys(self._ids, 0)
        self._due_ns = dict.fromkeys(self._ids, 0)

    def to_ask(self, now_ns: int) -> tuple[int, ...]:
        """Return the motors that the next request asks: the healthy ones, then at most one mute motor whose wait
        has ended.

        The mute motor is last, so that its silence does not delay the replies of the others. If no motor is
        healthy, return all motors.
        """
        mute = self.mute()
        healthy = tuple(i for i in self._ids if i not in mute)
        if not healthy:
            return self._ids
        due = [i for i in mute if self._due_ns[i] <= now_ns]
        return (*healthy, *sorted(due, key=self._due_ns.__getitem__)[:1])

    def update(self, requested: Iterable[int], answers: Iterable[int], now_ns: int) -> None:
        answered = frozenset(answers)
        for motor in requested:
            if motor in answered:
                self._misses[motor] = 0
                continue
            self._misses[motor] += 1
            step = self._misses[motor] - MISSES_TOLERATED - 1
            if step >= 0:
                wait_s = BACKOFF_S[min(step, len(BACKOFF_S) - 1)]
                self._due_ns[motor] = now_ns + round(wait_s * NS)

    def mute(self) -> tuple[int, ...]:
        """Return the motors that did not answer two requests in a row."""
        return tuple(i for i in self._ids if self._misses[i] > MISSES_TOLERATED)

    def silent(self) -> tuple[int, ...]:
        """Return the motors that did not answer the last request."""
        return tuple(i for i in self._ids if self._misses[i])
