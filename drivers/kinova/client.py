"""Send requests to a base on one connection and session, and match the responses by number.

Only ``listen``, and the methods that use it, wait. A request leaves at once. A response belongs to the
request with the same number, however late it arrives.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Awaitable, Callable
from typing import NamedTuple

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.tcp_port import ByteStream, TcpPort
from strands_actors.kernel.clock import NS, Clock

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


class Page:
    """A session's id and the number of its last request, in memory that two processes may share."""

    def __init__(self, memory: bytearray | mmap.mmap) -> None:
        self._memory = memory

    @property
    def session(self) -> int:
        return int(_PAGE.unpack_from(self._memory)[0])

    def begin(self, session: int) -> None:
        """Set the id of the session."""
        _PAGE.pack_into(self._memory, 0, session, _PAGE.unpack_from(self._memory)[1])

    def next_number(self) -> int:
        """Return the number of the next request. It counts from 1 to 65535, then starts again."""
        session, number = _PAGE.unpack_from(self._memory)
        number = number % 0xFFFF + 1
        _PAGE.pack_into(self._memory, 0, session, number)
        return int(number)


class Refusal(NamedTuple):
    """The base refused a call."""

    call: int
    sub_error: int

    @property
    def text(self) -> str:
        name = self.call if self.call not in tuple(Call) else Call(self.call).name
        return f"the base refuses {name}: {p.sub_error_name(self.sub_error)}"


class CallRefused(WireDown):
    """The base responded with an error."""


class KortexClient:
    """A client for one connection and session. Its calls never overlap.

    Args:
        name: The base's name in error messages.
        page: Id and counter of a session that is already open; by default there is no session yet.
    """

    def __init__(self, stream: ByteStream, name: str, clock: Clock, page: Page | None = None) -> None:
        self.page = page or Page(bytearray(_PAGE.size))
        self.refusal: Refusal | None = None
        """The last refusal of joint speeds."""
        self._stream = stream
        self._name = name
        self._clock = clock
        self._decoder = p.Decoder()
        self._open: dict[int, int] = {}  # number of an unanswered request -> its call
        self._awaited: dict[int, Frame | None] = {}  # responses that a caller will read
        self._waiting_since_ns = 0  # time of the last response, or of the first request after it
        self._asked_ns = 0

    def tell(self, call: Call, payload: bytes = b"") -> None:
        """Send a request without reading its response. Raise ``WireDown``.

        If the base refuses joint speeds, ``refusal`` is set once that response has been read.
        """
        self._send(call, payload)

    def ask(self, call: Call, payload: bytes = b"") -> int:
        """Send a request and return its number for ``answer``, ``taken`` or ``forget``. Raise ``WireDown``."""
        number = self._send(call, payload)
        self._awaited[number] = None
        return number

    async def listen(self, number: int, within_s: float) -> None:
        """Read until the response with this number has arrived or ``within_s`` have passed.

        Raises:
            WireDown: Requests are open, and the base has sent no response for ``SILENT_S``.
        """
        with trio.move_on_after(within_s):
            while number in self._awaited and self._awaited[number] is None:
                self._take(await self._stream.read())
        silent_s = (self._clock.now_ns() - self._waiting_since_ns) / NS
        if self._open and silent_s > SILENT_S:
            raise WireDown(f"{self._name}: no answer for {silent_s * 1e3:.0f} ms. Check its power, then reconnect")

    async def answer(self, number: int, within_s: float) -> Frame | None:
        """Wait for a response. Return it, or None if it has not arrived yet. Raise as ``listen``."""
        await self.listen(number, within_s)
        return self.taken(number)

    def taken(self, number: int) -> Frame | None:
        """Return the response if it has been read, else None."""
        return None if self._awaited.get(number) is None else self._awaited.pop(number)

    def forget(self, number: int) -> None:
        """Discard the response to a request. It may still arrive."""
        self._awaited.pop(number, None)

    async def call(self, call: Call, payload: bytes = b"", within_s: float = HANDSHAKE_S) -> Frame:
        """Send a request and wait for its response. Raise ``WireDown`` if the base refuses or does not
        respond."""
        number = self.ask(call, payload)
        try:
            response = await self.answer(number, within_s)
        finally:
            self.forget(number)
        if response is None:
            raise WireDown(f"{self._name}: no answer to {call.name} within {within_s:g} s. Check the base")
        if response.error:
            raise CallRefused(f"{self._name}: {Refusal(call, response.sub_error).text}")
        return response

    async def number(self, call: Call) -> int:
        """Send a request whose response is one number, and return the number. Raise ``WireDown``."""
        response = await self.call(call)
        try:
            return p.decode_number(response.payload)
        except MalformedFrame as error:
            raise WireDown(f"{self._name}: {call.name}: {error}") from None

    async def log_in(self, username: str, password: str) -> None:
        """Open a session. Raise ``WireDown``, without the password in its text."""
        try:
            created = await self.call(Call.CREATE_SESSION, p.Login(username, password).encode())
        except CallRefused as refused:
            raise WireDown(f"{refused}. Check username= and password=, and who else is connected") from None
        self.page.begin(created.session)

    def reset_if_stalled(self) -> bool:
        """As ``TcpPort.reset_if_stalled``."""
        return isinstance(self._stream, TcpPort) and self._stream.reset_if_stalled()

    def close(self) -> None:
        self._stream.close()

    def _send(self, call: Call, payload: bytes) -> int:
        now_ns = self._clock.now_ns()
        if not self._open or now_ns - self._asked_ns > SILENT_S * NS:
            self._waiting_since_ns = now_ns  # No request was open, or none was sent for SILENT_S.
        self._asked_ns = now_ns
        number = self.page.next_number()
        self._stream.write(Frame(p.Kind.REQUEST, call, number, self.page.session, payload).encode())
        if len(self._open) >= MAX_OPEN:
            del self._open[next(iter(self._open))]
        self._open[number] = call
        return number

    def _take(self, data: bytes) -> None:
        for frame in self._decoder.feed(data):
            asked = self._open.pop(frame.message, None) if frame.kind == p.Kind.RESPONSE else None
            if asked != frame.call:
                continue  # A notification, a response to an earlier client, or a damaged frame.
            self._waiting_since_ns = self._clock.now_ns()
            if frame.message in self._awaited:
                self._awaited[frame.message] = frame
            elif frame.error and frame.call == Call.SEND_JOINT_SPEEDS:
                self.refusal = Refusal(frame.call, frame.sub_error)


async def log_in_at(
    host: str, port: int, login: tuple[str, str], clock: Clock, open_stream: OpenStream
) -> KortexClient:
    """Connect and open a session. Raise ``WireDown``."""
    client = KortexClient(await open_stream(host, port), f"{host}:{port}", clock)
    try:
        await client.log_in(*login)
    except BaseException:
        client.close()
        raise
    return client
