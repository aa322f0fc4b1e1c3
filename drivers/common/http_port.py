"""One kept connection to a service, as small as a stop channel must be: HTTP/1.1 over ``tcp_port``.

A request is handed to the system in ``send``, at once or never: nothing waits to be sent, and
nothing is sent again by itself. Responses come in the order of the requests.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import trio

from strands_actors.contract.wire import WireDown

from .http_messages import Response, ResponseDecoder, encode_request
from .malformed import MalformedFrame
from .shared_stream import SharedStream
from .tcp_port import ByteStream, open_tcp

OpenStream = Callable[[str, int], Awaitable[ByteStream]]

REOPEN_S = 0.2
"""Pause before a connection that the service has closed is made anew."""

IDLE_S = 2.0
"""A connection on which nothing was said for so long takes no command: services close such ones
(uvicorn and hypercorn after 5 s), and what is sent just then is never answered."""

KEPT = 8
"""Responses that nobody has asked for yet."""


class HttpPort:
    """``serve`` keeps a connection open, where the next request has to leave without a wait."""

    def __init__(self, host: str, port: int, open_stream: OpenStream = open_tcp) -> None:
        self._where = host, port
        self.name = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        self._open_stream = open_stream
        self._stream = SharedStream(self._forget)
        self._decoder = ResponseDecoder()
        self._sent = self._heard = 0  # requests, and responses to them, on this connection
        self._used_s = 0.0  # when it was last opened, sent to or heard
        self._responses: dict[int, Response] = {}  # the newest few, by number

    @property
    def is_open(self) -> bool:
        return self._stream.connection is not None

    @property
    def waits(self) -> bool:
        """Return whether a request has not been answered."""
        return self._sent != self._heard

    async def open(self) -> None:
        """Connect anew. Raise ``WireDown``."""
        self.close()
        stream = await self._open_stream(*self._where)
        if self.is_open:  # somebody else was quicker, and may have sent on it
            stream.close()
            return
        self._stream.replace(stream)
        self._used_s = trio.current_time()

    async def ready(self) -> None:
        """Connect anew unless there is a connection that was used lately, or has not answered yet.
        Raise ``WireDown``."""
        if not self.is_open or (not self.waits and trio.current_time() - self._used_s > IDLE_S):
            await self.open()

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Keep a connection open until cancelled. ``started`` with the first; raise ``WireDown``
        without one."""
        await self.open()
        task_status.started()
        while True:
            try:
                if not self.is_open:
                    await self.open()
                await self.hear()
            except WireDown:
                self.close()
            await trio.sleep(REOPEN_S)

    async def hear(self) -> None:
        """Take in what arrives until the connection is closed. Raise ``WireDown`` when it is
        lost."""
        while self.is_open:
            await self._hear()

    def send(self, method: str, target: str, body: bytes = b"") -> int:
        """Hand a request over now; return its number on this connection. Raise ``WireDown``."""
        if not self.is_open:
            raise WireDown(f"{self.name}: not connected. Reconnect")
        self._stream.write(encode_request(method, target, self.name, body))
        self._sent += 1
        self._used_s = trio.current_time()
        return self._sent

    async def answer(self, number: int, within_s: float) -> Response:
        """Return the response to that request. Raise ``WireDown``, and close the connection, when
        none comes in time or what comes is no HTTP."""
        asked = self._stream.connection
        with trio.move_on_after(within_s):
            while self.is_open and self._stream.connection is asked and self._heard < number:
                await self._hear()
            if self._stream.connection is asked and number in self._responses:
                return self._responses[number]
            raise WireDown(f"{self.name}: the connection was closed before the answer. Check the service")
        if self._stream.connection is asked:
            self.close()  # a late answer could pass for the next
        raise WireDown(f"{self.name}: no answer within {within_s * 1e3:.0f} ms. Check the service and its network")

    async def ask(self, method: str, target: str, body: bytes = b"", *, within_s: float) -> Response:
        """``send`` and ``answer``, on a connection made for it where there is none. Raise
        ``WireDown``."""
        if not self.is_open:
            await self.open()
        return await self.answer(self.send(method, target, body), within_s)

    def close(self) -> None:
        """Throw the connection away. Harmless when called again."""
        self._stream.close()

    def _forget(self) -> None:
        self._decoder = ResponseDecoder()
        self._sent = self._heard = 0
        self._responses.clear()

    async def _hear(self) -> None:
        """Take in what comes next, or wait until somebody else did. Raise ``WireDown``."""
        data = await self._stream.read()
        if not data:
            return
        self._used_s = trio.current_time()
        try:
            for response in self._decoder.feed(data):
                self._heard += 1
                if self._heard > self._sent:
                    raise MalformedFrame("response to no request")
                self._responses[self._heard] = response
                self._responses.pop(self._heard - KEPT, None)
        except MalformedFrame as malformed:
            self.close()
            raise WireDown(f"{self.name}: {malformed}. Check what is served there") from None
