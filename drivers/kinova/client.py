"""One connection to a base, one session on it: questions out, answers by their number.

Nothing here waits but ``answer``: what is asked leaves at once. An answer belongs to the question
whose number it bears, however late it comes.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Awaitable, Callable
from typing import NamedTuple

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.tcp_port import ByteStream, TcpPort
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from .protocol import Call, Frame

OpenStream = Callable[[str, int], Awaitable[ByteStream]]

SILENT_S = 0.5
"""A base that was asked and has said nothing for so long is gone."""

HANDSHAKE_S = 0.6
"""More than that: what connects and does not speak is told as such."""

MAX_OPEN = 256
"""Questions without an answer that are remembered; the oldest is forgotten for a new one."""

_PAGE = struct.Struct("<HH")


class Page:
    """A session's id and the number of its last question, in memory that another process may
    share."""

    def __init__(self, memory: bytearray | mmap.mmap) -> None:
        self._memory = memory

    @property
    def session(self) -> int:
        return int(_PAGE.unpack_from(self._memory)[0])

    def begin(self, session: int) -> None:
        """Note a session."""
        _PAGE.pack_into(self._memory, 0, session, _PAGE.unpack_from(self._memory)[1])

    def next_number(self) -> int:
        """Return the number of the next question: 1 to 65535, then anew."""
        session, number = _PAGE.unpack_from(self._memory)
        number = number % 0xFFFF + 1
        _PAGE.pack_into(self._memory, 0, session, number)
        return int(number)


class Refusal(NamedTuple):
    """The base did not do what it was told."""

    call: int
    sub_error: int

    @property
    def text(self) -> str:
        name = self.call if self.call not in tuple(Call) else Call(self.call).name
        return f"the base refuses {name}: {p.sub_error_name(self.sub_error)}"


class CallRefused(WireDown):
    """The base answers, and does not do it."""


class KortexClient:
    """Calls never overlap."""

    def __init__(self, stream: ByteStream, name: str, clock: Clock, page: Page | None = None) -> None:
        """``page``: of a session that was opened already; default: none was."""
        self.page = page or Page(bytearray(_PAGE.size))
        self.refusal: Refusal | None = None
        """Of joint speeds; the last one."""
        self._stream = stream
        self._name = name
        self._clock = clock
        self._decoder = p.Decoder()
        self._open: dict[int, int] = {}  # number of a question without an answer -> what was asked
        self._awaited: dict[int, Frame | None] = {}  # the answers that somebody wants
        self._waiting_since_ns = 0  # when it was last heard, or since when it was asked
        self._asked_ns = 0

    def tell(self, call: Call, payload: bytes = b"") -> None:
        """Send at once. That joint speeds were refused stands in ``refusal`` when the answer has
        been read. Raise ``WireDown``."""
        self._send(call, payload)

    def ask(self, call: Call, payload: bytes = b"") -> int:
        """Send at once; return a number to give to ``answer``, ``taken`` or ``forget``. Raise
        ``WireDown``."""
        number = self._send(call, payload)
        self._awaited[number] = None
        return number

    async def listen(self, number: int, within_s: float) -> None:
        """Take what comes until that answer has come. Raise ``WireDown`` when the base was asked
        and has said nothing for ``SILENT_S``."""
        with trio.move_on_after(within_s):
            while number in self._awaited and self._awaited[number] is None:
                self._take(await self._stream.read())
        silent_s = (self._clock.now_ns() - self._waiting_since_ns) / NS
        if self._open and silent_s > SILENT_S:
            raise WireDown(f"{self._name}: no answer for {silent_s * 1e3:.0f} ms. Check its power, then reconnect")

    async def answer(self, number: int, within_s: float) -> Frame | None:
        """Return the answer, or None: not yet. Raise ``WireDown`` as ``listen``."""
        await self.listen(number, within_s)
        return self.taken(number)

    def taken(self, number: int) -> Frame | None:
        """Return the answer if it has been read."""
        return None if self._awaited.get(number) is None else self._awaited.pop(number)

    def forget(self, number: int) -> None:
        """The answer is of no more interest; it may still come."""
        self._awaited.pop(number, None)

    async def call(self, call: Call, payload: bytes = b"", within_s: float = HANDSHAKE_S) -> Frame:
        """Ask and wait. Raise ``WireDown`` when the base refuses, or does not answer."""
        number = self.ask(call, payload)
        try:
            found = await self.answer(number, within_s)
        finally:
            self.forget(number)
        if found is None:
            raise WireDown(f"{self._name}: no answer to {call.name} within {within_s:g} s. Check the base")
        if found.error:
            raise CallRefused(f"{self._name}: {Refusal(call, found.sub_error).text}")
        return found

    async def number(self, call: Call) -> int:
        """Ask for what is one number. Raise ``WireDown``."""
        found = await self.call(call)
        try:
            return p.decode_number(found.payload)
        except MalformedFrame as error:
            raise WireDown(f"{self._name}: {call.name}: {error}") from None

    async def log_in(self, username: str, password: str) -> None:
        """Open a session. Raise ``WireDown``, which names no password."""
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
            self._waiting_since_ns = now_ns  # nobody was waiting, or nobody asked
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
                continue  # a notification, an answer to somebody before us, or one that is damaged
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
