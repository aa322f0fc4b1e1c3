"""One kept connection to a service: HTTP/1.1 by h11 over ``tcp_port``, a deadline on every wait.

A request is handed to the system in ``send``, at once or never: nothing waits to be sent, and
nothing is sent again, redirected, or asked of a proxy. Responses come in the order of the requests.
A request that may move a robot takes a permit, which is checked directly before it leaves, whole.

When what comes is no HTTP, nothing more is read. The connection is kept for one purpose, which needs
no answer: ``send_stop``.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import trio

from strands_actors.contract.wire import Permit, WireDown

from .http_messages import MAX_BODY, ClientEnd, Response
from .malformed import MalformedFrame
from .shared_stream import SharedStream
from .tcp_port import OrderlyStream, open_tcp

OpenStream = Callable[[str, int], Awaitable[OrderlyStream]]

REOPEN_S = 0.2
"""Pause before a connection that the service has closed is made anew."""

IDLE_S = 2.0
"""A connection that was not used for so long takes no command: services close such ones (uvicorn and
hypercorn after 5 s), and what is sent just then is never answered."""

KEPT = 8
"""Responses that nobody has asked for yet."""

JSON = "application/json"


class HttpPort:
    """``serve`` keeps a connection open, where the next request has to leave without a wait."""

    def __init__(
        self, host: str, port: int, open_stream: OpenStream = open_tcp, *, max_body: int = MAX_BODY
    ) -> None:
        """Make a port that is not connected yet. ``max_body``: bytes of one answer."""
        self._where = host, port
        self.name = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        self._open_stream = open_stream
        self._max_body = max_body
        self._stream = SharedStream(self._forget)
        self._used_s = 0.0  # when it was last opened, sent to or heard
        self._forget()

    @property
    def is_open(self) -> bool:
        """Return whether a request can be sent that is answered."""
        return self._stream.connection is not None

    @property
    def waits(self) -> bool:
        """Return whether a request has not been answered."""
        return self._sent != self._heard

    async def open(self) -> None:
        """Connect anew. One that is not understood is kept until then. Raise ``WireDown``."""
        if self.is_open:
            self.close()
        stream = await self._open_stream(*self._where)
        if self.is_open:  # another task was quicker, and may have sent on it
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
                pass  # one that is not understood is kept for a stop until another is open
            await trio.sleep(REOPEN_S)

    async def hear(self) -> None:
        """Take in what arrives until the connection is closed. Raise ``WireDown`` when it is
        lost."""
        while self.is_open:
            await self._hear()

    def send(
        self, method: str, target: str, body: bytes = b"", *, permit: Permit | None = None, kind: str = JSON
    ) -> int:
        """Hand a request over now; return its number on this connection. Raise ``WireDown``, and
        ``PermitDenied`` before anything has left."""
        if not self.is_open:
            raise WireDown(f"{self.name}: not connected. Reconnect")
        if permit is not None:
            permit.check()
        self._stream.write(self._end.request(method, target, body, kind))
        return self._count()

    def send_stop(self, method: str, target: str, body: bytes = b"") -> int:
        """As ``send``, on a connection that is not understood any more, too: a stop needs no
        answer. Raise ``WireDown`` where nothing is open."""
        self._stream.write_stop(self._end.request(method, target, body))
        return self._count()

    async def answer(self, number: int, within_s: float) -> Response:
        """Return the response to that request. Raise ``WireDown``, and close the connection, when
        none comes in time; when what comes is no HTTP it is kept for a stop."""
        asked = self._stream.connection
        with trio.move_on_after(within_s):
            while self.is_open and self._stream.connection is asked and self._heard < number:
                await self._hear()
            if self._stream.connection is asked and number in self._responses:
                return self._responses[number]
            raise WireDown(f"{self.name}: the connection was lost before the answer. Check the service")
        if self._stream.connection is asked:
            self.close()  # a late answer could pass for the next
        raise WireDown(f"{self.name}: no answer within {within_s * 1e3:.0f} ms. Check the service and its network")

    async def ask(
        self,
        method: str,
        target: str,
        body: bytes = b"",
        *,
        within_s: float,
        permit: Permit | None = None,
        kind: str = JSON,
    ) -> Response:
        """``send`` and ``answer``, on a connection made for it where none was used lately. Raise
        ``WireDown``, and ``PermitDenied`` before anything has left."""
        with trio.move_on_after(within_s) as scope:
            await self.ready()
        if not self.is_open:
            raise WireDown(f"{self.name}: no connection within {within_s * 1e3:.0f} ms. Check the service")
        number = self.send(method, target, body, permit=permit, kind=kind)
        return await self.answer(number, scope.deadline - trio.current_time())

    def close(self) -> None:
        """Throw the connection away. Harmless when called again."""
        self._stream.close()

    def close_in_order(self) -> None:
        """As ``close``, but what was sent still arrives: for one on which stops were sent."""
        self._stream.close(in_order=True)

    def _forget(self) -> None:
        self._end = ClientEnd(self.name, self._max_body)
        self._sent = self._heard = 0  # requests, and responses to them, on this connection
        self._responses: dict[int, Response] = {}  # the newest few, by number

    def _count(self) -> int:
        self._sent += 1
        self._used_s = trio.current_time()
        return self._sent

    async def _hear(self) -> None:
        """Take in what comes next, or wait until another task did. Raise ``WireDown``."""
        end, data = self._end, b""
        if end.has_unread:
            await trio.lowlevel.checkpoint()  # others get their turn, and may have closed it
        else:
            data = await self._stream.read()
        if end is not self._end or not (data or end.has_unread):
            return
        self._used_s = trio.current_time()
        try:
            for response in end.feed(data):
                self._heard += 1
                self._responses[self._heard] = response
                self._responses.pop(self._heard - KEPT, None)
        except MalformedFrame as malformed:
            self._stream.deafen(str(malformed))
            raise WireDown(f"{self.name}: {malformed}. Check what is served there") from None
