"""A WebSocket client for a wire process or a stop channel: wsproto over ``tcp_port``, a deadline on
every wait.

One object is one connection. ``send`` hands a message to the system at once or raises: nothing
waits to be sent, and nothing is sent again on a later connection. It is closed with a reset, so
that what has not arrived yet is thrown away; what waits in the other end's own buffer it may still
take. Check a permit directly before ``send``: there is no wait in it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable
from typing import Protocol

import trio

from strands_actors.contract.wire import WireDown

from .malformed import MalformedFrame
from .tcp_port import ByteStream, open_tcp
from .websocket_messages import MAX_MESSAGE, Accepted, ClientEnd, Closed, Headers, Heard, Ponged, Rejected


class Stream(ByteStream, Protocol):
    def close_in_order(self) -> None: ...


OpenStream = Callable[[str, int], Awaitable[Stream]]


class WebSocket:
    """An open connection. One task calls ``receive``; whoever has a message calls ``send``."""

    def __init__(self, name: str, stream: Stream, end: ClientEnd, heard: deque[Heard]) -> None:
        """Made by ``open_websocket``. ``heard``: what came with the answer to the upgrade."""
        self.name = name
        self._stream = stream
        self._end = end
        self._heard = heard  # of the bytes last read; read again only when it is empty
        self._pinged = self._ponged = 0
        self._news = trio.Event()
        self._reader: trio.CancelScope | None = None
        self._why = ""  # it is closed

    @property
    def is_open(self) -> bool:
        return not self._why

    def send(self, message: str | bytes) -> None:
        """Send a text or binary message now. Raise ``WireDown``, and be closed, when it does not
        leave whole. Raise ``ValueError`` for one that is too long."""
        self._check()
        try:
            frame = self._end.message(message)
        except MalformedFrame as malformed:
            raise ValueError(f"{self.name}: {malformed}") from None
        self._write(frame)

    async def receive(self) -> str | bytes:
        """Return the next message. Answer pings meanwhile. Raise ``WireDown``, and be closed, when
        there is none any more. May be cancelled at any time; nothing is lost."""
        while True:
            while self._heard:
                match self._heard.popleft():
                    case str() | bytes() as message:
                        return message
                    case Ponged(payload) if payload.isdigit() and int(payload) <= self._pinged:
                        self._ponged = max(self._ponged, int(payload))
                        self._wake()
                    case Closed(code, reason):
                        raise self._gone(f"the service closed it: {code} {reason}".rstrip())
            try:
                self._heard.extend(self._end.feed(await self._read()))
            except MalformedFrame as malformed:
                raise self._gone(str(malformed)) from None
            if replies := self._end.replies():
                self._write(replies)

    async def receive_within(self, within_s: float) -> str | bytes:
        """As ``receive``. Raise ``WireDown`` when nothing comes in time; the connection stays
        open."""
        with trio.move_on_after(within_s):
            return await self.receive()
        raise WireDown(f"{self.name}: no message within {within_s * 1e3:.0f} ms. Check the service and its network")

    def ping(self) -> int:
        """Send a ping now; return its number for ``ponged``. Raise ``WireDown``."""
        self._check()
        self._pinged += 1
        self._write(self._end.ping(str(self._pinged).encode()))
        return self._pinged

    async def ponged(self, number: int, within_s: float) -> None:
        """Return when the service has answered that ping: it has read everything that was sent
        before. Another task receives meanwhile. Raise ``WireDown`` when it does not come in
        time."""
        with trio.move_on_after(within_s):
            while self._ponged < number:
                self._check()
                await self._news.wait()
            return
        raise WireDown(f"{self.name}: no pong within {within_s * 1e3:.0f} ms. Check the service and its network")

    def close(self) -> None:
        """Throw the connection away with what has not arrived yet. Harmless when called again."""
        self._gone("closed by us")

    def close_in_order(self) -> None:
        """As ``close``, but what was sent still arrives, and a close frame behind it: for a
        stop."""
        if not self._why:
            try:
                self._stream.write(self._end.close())
            except WireDown as down:
                self._gone(str(down))
                return
            self._stream.close_in_order()
        self._gone("closed by us")

    async def _read(self) -> bytes:
        self._check()
        data = b""
        try:
            with trio.CancelScope() as self._reader:  # cancelled by ``close``: nothing else ends the wait
                data = await self._stream.read()
        except WireDown as down:
            raise self._gone(str(down)) from None
        finally:
            self._reader = None
        self._check()
        return data

    def _write(self, data: bytes) -> None:
        try:
            self._stream.write(data)
        except WireDown as down:
            raise self._gone(str(down)) from None

    def _check(self) -> None:
        if self._why:
            raise WireDown(f"{self.name}: the WebSocket is closed ({self._why}). Reconnect")

    def _gone(self, why: str) -> WireDown:
        if not self._why:
            self._why = why
            self._heard.clear()
            if self._reader is not None:
                self._reader.cancel()
            self._stream.close()
            self._wake()
        return WireDown(f"{self.name}: {why}. Check the service and its network, then reconnect")

    def _wake(self) -> None:
        news, self._news = self._news, trio.Event()
        news.set()


async def open_websocket(
    host: str,
    port: int,
    target: str = "/",
    *,
    within_s: float,
    headers: Headers = (),
    max_message: int = MAX_MESSAGE,
    open_stream: OpenStream = open_tcp,
) -> WebSocket:
    """Connect and upgrade within ``within_s``. Raise ``WireDown``."""
    name = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    end = ClientEnd(name, target, headers, max_message)
    stream: Stream | None = None
    try:
        with trio.move_on_after(within_s):
            stream = await open_stream(host, port)
            stream.write(end.request)
            opened = WebSocket(name, stream, end, await _upgraded(name, stream, end, target))
            stream = None
            return opened
    finally:
        if stream is not None:
            stream.close()
    raise WireDown(f"{name}: {target}: no WebSocket within {within_s * 1e3:.0f} ms. Check the service")


async def _upgraded(name: str, stream: Stream, end: ClientEnd, target: str) -> deque[Heard]:
    """Wait for the answer to the upgrade; return what came behind it."""
    why = "it ends without an answer"
    while True:
        data = await stream.read()
        try:
            heard = deque(end.feed(data))
        except MalformedFrame as malformed:
            why = str(malformed)
            break
        if not heard:
            continue
        match heard.popleft():
            case Accepted():
                return heard
            case Rejected(status):
                why = f"it answers status {status}"
                break
            case _:
                break
    raise WireDown(f"{name}: {target}: no WebSocket there ({why}). Check what is served there")
