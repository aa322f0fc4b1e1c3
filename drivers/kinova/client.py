"""Send requests to a base on one connection and session, and match the responses by number.

Requests are sent without waiting. Only ``listen``, and the methods that call it, wait for responses. A response
belongs to the request with the same number, even if it arrives late.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Awaitable, Callable
from typing import NamedTuple, Protocol, runtime_checkable

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.exchange import Exchange
from strands_actors.drivers.common.ports.tcp_port import ByteStream
from strands_actors.kernel.clock import Clock

from . import protocol as p
from .protocol import Call, Frame

OpenStream = Callable[[str, int], Awaitable[ByteStream]]

SILENT_S = 0.5
"""A base counts as gone if requests get no response for this long."""

HANDSHAKE_S = 0.6
"""Timeout of a call. It is longer than ``SILENT_S``, so that a peer that accepts the connection but never
responds is reported as silent."""

MAX_OPEN = 256
"""Number of unanswered requests to remember. A new one replaces the oldest."""

_PAGE = struct.Struct("<HH")


@runtime_checkable
class ResettableStream(ByteStream, Protocol):
    """A connection that can be reset for every process that has it open. ``TcpPort`` is one."""

    def reset_if_stalled(self) -> bool: ...
    def reset(self) -> None: ...


class Page:
    """The id of a session and the number of its last request.

    They may be in shared memory, so that a second process can send requests in the same session.
    """

    def __init__(self, memory: bytearray | mmap.mmap) -> None:
        self._memory = memory

    @property
    def session(self) -> int:
        return int(_PAGE.unpack_from(self._memory)[0])

    def begin(self, session: int) -> None:
        """Store the id of a new session."""
        _PAGE.pack_into(self._memory, 0, session, _PAGE.unpack_from(self._memory)[1])

    def next_number(self) -> int:
        """Count up and return the number of the next request: 1 to 65535, then 1 again."""
        session, number = _PAGE.unpack_from(self._memory)
        number = number % 0xFFFF + 1
        _PAGE.pack_into(self._memory, 0, session, number)
        return int(number)


class Refusal(NamedTuple):
    """The reason why the base refused a call."""

    call: int
    sub_error: int

    @property
    def text(self) -> str:
        name = self.call if self.call not in tuple(Call) else Call(self.call).name
        return f"the base refuses {name}: {p.sub_error_name(self.sub_error)}"


class CallRefused(WireDown):
    """Raised when the base answers a call with an error."""


class KortexClient:
    """A Kortex client with one connection and one session.

    Args:
        stream: The connection.
        name: The base's name in error messages.
        clock: The clock for timeouts.
        page: Id and request counter of a session that is already open. By default no session is open.
    """

    def __init__(self, stream: ByteStream, name: str, clock: Clock, page: Page | None = None) -> None:
        self.page = page or Page(bytearray(_PAGE.size))
        self.refusal: Refusal | None = None
        """The last refusal of joint speeds."""
        self.hand_refusal: Refusal | None = None
        """The refusal of the newest gripper command; None if the base accepted it."""
        self._stream = stream
        self._name = name
        self._clock = clock
        self._decoder = p.Decoder()
        # For each request its function (``Call``).
        self._exchange: Exchange[int, int, Frame] = Exchange(MAX_OPEN)

    def tell(self, call: Call, payload: bytes = b"") -> None:
        """Send a request for which no caller waits. Raise ``WireDown`` if the connection is lost.

        If the base refuses joint speeds, a later ``listen`` stores the reason in ``refusal``.
        """
        self._send(call, payload, awaited=False)

    def ask(self, call: Call, payload: bytes = b"") -> int:
        """Send a request without waiting. Raise ``WireDown`` if the connection is lost.

        Return the number of the request. Later pass it to ``answer`` or ``pop_response`` for the response, or to
        ``forget``.
        """
        return self._send(call, payload, awaited=True)

    async def listen(self, number: int, within_s: float) -> None:
        """Read until the response with this number has arrived or ``within_s`` seconds have passed.

        Raises:
            WireDown: The base has not responded to any request for ``SILENT_S``, or the connection is lost.
        """
        await self._exchange.wait(within_s, self._receive, number)
        silent_s = self._exchange.silent_s(self._clock.now_ns())
        if silent_s > SILENT_S:
            raise WireDown(
                f"{self._name}: the base did not answer for {silent_s * 1e3:.0f} ms. "
                "Check its power, then reconnect"
            )

    async def answer(self, number: int, within_s: float) -> Frame | None:
        """Wait for the response to a request for at most ``within_s`` seconds.

        Return the response, or None if it has not arrived in time. Raise the same errors as ``listen``.
        """
        await self.listen(number, within_s)
        return self.pop_response(number)

    def pop_response(self, number: int) -> Frame | None:
        """Return the response to a request if it has already arrived, else None. Never waits."""
        return self._exchange.pop(number)

    def forget(self, number: int) -> None:
        """Discard the response to a request, whether it has arrived or arrives later."""
        self._exchange.forget(number)

    async def call(self, call: Call, payload: bytes = b"", within_s: float = HANDSHAKE_S) -> Frame:
        """Send a request and wait for its response. Raise ``WireDown`` if the base refuses or does not
        respond."""
        number = self.ask(call, payload)
        try:
            response = await self.answer(number, within_s)
        finally:
            self.forget(number)
        if response is None:
            raise WireDown(
                f"{self._name}: the base did not answer {call.name} within {within_s:g} s. Check its power"
            )
        if response.error:
            raise CallRefused(f"{self._name}: {Refusal(call, response.sub_error).text}")
        return response

    async def number(self, call: Call) -> int:
        """Send a request, and return the one number in its response. Raise ``WireDown``."""
        response = await self.call(call)
        try:
            return p.decode_number(response.payload)
        except MalformedFrame as error:
            raise WireDown(f"{self._name}: {call.name}: {error}") from None

    async def log_in(self, username: str, password: str) -> None:
        """Open a session. Raise ``WireDown`` if the base refuses. The error's text never has the password."""
        try:
            created = await self.call(Call.CREATE_SESSION, p.Login(username, password).encode())
        except CallRefused as refused:
            raise WireDown(f"{refused}. Check username= and password=, and disconnect other clients") from None
        self.page.begin(created.session)

    def reset_if_stalled(self) -> bool:
        """Reset the connection if sent bytes are stuck in it. Return True if it was reset."""
        return isinstance(self._stream, ResettableStream) and self._stream.reset_if_stalled()

    def reset(self) -> None:
        """Reset the connection for every process that has it open. Requests that wait there are dropped."""
        if isinstance(self._stream, ResettableStream):
            self._stream.reset()

    def close(self) -> None:
        self._stream.close()

    def _send(self, call: Call, payload: bytes, awaited: bool) -> int:
        number = self.page.next_number()
        self._stream.write(Frame(p.Kind.REQUEST, call, number, self.page.session, payload).encode())
        self._exchange.sent(number, call, self._clock.now_ns(), awaited=awaited)
        return number

    async def _receive(self) -> None:
        for frame in self._decoder.feed(await self._stream.read()):
            if frame.kind != p.Kind.RESPONSE or self._exchange.request(frame.message) != frame.call:
                continue  # Ignore notifications, responses to an earlier client, and damaged frames.
            self._exchange.received(self._clock.now_ns())
            sent = self._exchange.take(frame.message, frame)
            if sent and not sent.is_awaited and frame.error and frame.call == Call.SEND_JOINT_SPEEDS:
                self.refusal = Refusal(frame.call, frame.sub_error)
            if sent and not sent.is_awaited and frame.call == Call.SEND_GRIPPER_COMMAND:
                self.hand_refusal = Refusal(frame.call, frame.sub_error) if frame.error else None


async def log_in_at(
    host: str, port: int, login: tuple[str, str], clock: Clock, open_stream: OpenStream
) -> KortexClient:
    """Connect to a base and open a session. Return the client. Raise ``WireDown`` if that fails."""
    client = KortexClient(await open_stream(host, port), f"{host}:{port}", clock)
    try:
        await client.log_in(*login)
    except BaseException:
        client.close()
        raise
    return client
