"""One persistent connection to a service: HTTP/1.1 by h11 over ``tcp_port``, with a deadline on every
wait.

``send`` hands a request to the system at once, or fails. No request waits to be sent, is sent again,
follows a redirect, or goes through a proxy. Responses come in the order of the requests. A request that
may move a robot takes a permit, which is checked immediately before the whole request leaves.

If the received data is no HTTP, nothing more is read. The connection is kept for ``send_stop`` only,
which needs no answer.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import trio

from strands_actors.contract.wire import Permit, WireDown

from ..codecs.http_messages import MAX_BODY, ClientEnd, Response
from ..codecs.malformed import MalformedFrame
from .shared_stream import SharedStream
from .tcp_port import OrderlyStream, open_tcp

OpenStream = Callable[[str, int], Awaitable[OrderlyStream]]

REOPEN_S = 0.2
"""Pause before a connection that the service has closed is made again."""

IDLE_S = 2.0
"""A connection that was idle for so long takes no command. Services close idle connections (uvicorn and
hypercorn after 5 s), and a request that is sent at that moment is never answered."""

KEPT = 8
"""Number of unclaimed responses that are kept."""

JSON = "application/json"


class HttpPort:
    """A connection to one service. ``serve`` keeps it open for wires on which the next request must leave
    without a wait."""

    def __init__(
        self, host: str, port: int, open_stream: OpenStream = open_tcp, *, max_body: int = MAX_BODY
    ) -> None:
        """Make a port that is not connected yet.

        Args:
            host: Name or address of the service.
            port: Its port.
            open_stream: Makes the connection. The default is plain TCP.
            max_body: Most bytes of one response.
        """
        self._where = host, port
        self.name = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        self._open_stream = open_stream
        self._max_body = max_body
        self._stream = SharedStream(self._forget)
        self._used_s = 0.0  # when it was last opened, or used to send or receive
        self._forget()

    @property
    def is_open(self) -> bool:
        """True if a request can be sent and its response read."""
        return self._stream.connection is not None

    @property
    def waits(self) -> bool:
        """True if a request is unanswered."""
        return self._sent != self._heard

    async def open(self) -> None:
        """Connect again. A connection with unreadable data is kept until the new one is open.

        Raises:
            WireDown: It cannot connect.
        """
        if self.is_open:
            self.close()
        stream = await self._open_stream(*self._where)
        if self.is_open:  # Another task was quicker, and may have sent on its connection.
            stream.close()
            return
        self._stream.replace(stream)
        self._used_s = trio.current_time()

    async def ready(self) -> None:
        """Connect again, unless a connection was used lately or has an unanswered request.

        Raises:
            WireDown: It cannot connect.
        """
        if not self.is_open or (not self.waits and trio.current_time() - self._used_s > IDLE_S):
            await self.open()

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Keep a connection open until cancelled. ``started()`` is called when the first is open.

        Raises:
            WireDown: The first connection failed.
        """
        await self.open()
        task_status.started()
        while True:
            try:
                if not self.is_open:
                    await self.open()
                await self.hear()
            except WireDown:
                pass  # A connection with unreadable data is kept for a stop until another is open.
            await trio.sleep(REOPEN_S)

    async def hear(self) -> None:
        """Receive until the connection is closed.

        Raises:
            WireDown: It was lost.
        """
        while self.is_open:
            await self._hear()

    def send(
        self, method: str, target: str, body: bytes = b"", *, permit: Permit | None = None, kind: str = JSON
    ) -> int:
        """Hand over a request now.

        Returns:
            Its number on this connection, for ``answer``.

        Raises:
            WireDown: It could not be sent.
            PermitDenied: Nothing has left.
        """
        if not self.is_open:
            raise WireDown(f"{self.name}: not connected. Reconnect")
        if permit is not None:
            permit.check()
        self._stream.write(self._end.request(method, target, body, kind))
        return self._count()

    def send_stop(self, method: str, target: str, body: bytes = b"") -> int:
        """As ``send``, also on a connection that received unreadable data, since a stop needs no answer.

        Raises:
            WireDown: No connection is open.
        """
        self._stream.write_stop(self._end.request(method, target, body))
        return self._count()

    async def answer(self, number: int, within_s: float) -> Response:
        """Return the response to a request.

        If it does not come in time, the connection is closed. If the received data is no HTTP, the
        connection is kept for a stop.

        Args:
            number: The result of ``send``.
            within_s: Time to wait.

        Raises:
            WireDown: There is no response.
        """
        asked = self._stream.connection
        with trio.move_on_after(within_s):
            while self.is_open and self._stream.connection is asked and self._heard < number:
                await self._hear()
            if self._stream.connection is asked and number in self._responses:
                return self._responses[number]
            raise WireDown(f"{self.name}: the connection was lost before the answer. Check the service")
        if self._stream.connection is asked:
            self.close()  # A late response could pass for the next one.
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
        """Send a request and return its response. Connect first if no connection was used lately.

        Raises:
            WireDown: There is no response within ``within_s``.
            PermitDenied: Nothing has left.
        """
        with trio.move_on_after(within_s) as scope:
            await self.ready()
        if not self.is_open:
            raise WireDown(f"{self.name}: no connection within {within_s * 1e3:.0f} ms. Check the service")
        number = self.send(method, target, body, permit=permit, kind=kind)
        return await self.answer(number, scope.deadline - trio.current_time())

    def close(self) -> None:
        """Reset the connection. Another call does nothing."""
        self._stream.close()

    def close_in_order(self) -> None:
        """As ``close``, but sent data still arrives. Meant for a connection that has carried a stop."""
        self._stream.close(in_order=True)

    def _forget(self) -> None:
        self._end = ClientEnd(self.name, self._max_body)
        self._sent = self._heard = 0  # requests and responses on this connection
        self._responses: dict[int, Response] = {}  # the newest ones, by number

    def _count(self) -> int:
        self._sent += 1
        self._used_s = trio.current_time()
        return self._sent

    async def _hear(self) -> None:
        """Receive once, or wait until another task has. Raise ``WireDown``."""
        end, data = self._end, b""
        if end.has_unread:
            await trio.lowlevel.checkpoint()  # Other tasks run, and one may have closed the connection.
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
