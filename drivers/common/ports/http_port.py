"""One persistent HTTP/1.1 connection to a service: h11 over ``tcp_port``, with a deadline on every wait.

``send`` hands a request to the operating system at once, or raises. No request is queued, sent again, redirected,
or sent through a proxy. Responses come in the order of the requests. A request that may move a robot needs a
``Permit`` (the permission to send this command now), which is checked immediately before the whole request is sent.

If the received data is no HTTP, nothing more is read. The connection is then kept only for ``send_stop``, which
needs no response.
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
    """A connection to one HTTP service. ``serve`` keeps it open, for robots whose next request must be sent without
    a wait."""

    def __init__(
        self, host: str, port: int, open_stream: OpenStream = open_tcp, *, max_body: int = MAX_BODY
    ) -> None:
        """Prepare a connection. Nothing is opened yet.

        Args:
            host: Name or address of the service.
            port: The service's port.
            open_stream: Makes the connection. The default is plain TCP.
            max_body: Most bytes of one response.
        """
        self._where = host, port
        self.name = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        self._open_stream = open_stream
        self._max_body = max_body
        self._stream = SharedStream(self._forget)
        self._used_s = 0.0  # time at which the connection was last opened, or sent or received data
        self._forget()

    @property
    def is_open(self) -> bool:
        """True if a request can be sent and its response read."""
        return self._stream.connection is not None

    @property
    def waits(self) -> bool:
        """True if a request was not answered yet."""
        return self._sent != self._received

    async def open(self) -> None:
        """Open a new connection. A connection on which malformed data was received is kept until the new one is
        open.

        Raises:
            WireDown: The connect failed.
        """
        if self.is_open:
            self.close()
        stream = await self._open_stream(*self._where)
        # If another task has connected meanwhile, it may have sent a request. So keep the connection of that task
        # and close this one.
        if self.is_open:
            stream.close()
            return
        self._stream.replace(stream)
        self._used_s = trio.current_time()

    async def ready(self) -> None:
        """Open a new connection, unless the present one was used within ``IDLE_S`` or waits for a response.

        Raises:
            WireDown: The connect failed.
        """
        if not self.is_open or (not self.waits and trio.current_time() - self._used_s > IDLE_S):
            await self.open()

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Keep a connection open until cancelled. ``started()`` is called once the first connection is open.

        Raises:
            WireDown: The first connect failed.
        """
        await self.open()
        task_status.started()
        while True:
            try:
                if not self.is_open:
                    await self.open()
                await self.hear()
            except WireDown:
                # A connection with malformed data is kept until another one is open, because a stop can still be
                # sent on it.
                pass
            await trio.sleep(REOPEN_S)

    async def hear(self) -> None:
        """Receive responses until the connection is closed.

        Raises:
            WireDown: The connection was lost.
        """
        while self.is_open:
            await self._hear()

    def send(
        self, method: str, target: str, body: bytes = b"", *, permit: Permit | None = None, content_type: str = JSON
    ) -> int:
        """Send a request now.

        Returns:
            The number of the request on this connection, for ``answer``.

        Raises:
            WireDown: The request could not be sent.
            PermitDenied: ``permit`` no longer allows this command, for example after a stop. Nothing was sent.
        """
        if not self.is_open:
            raise WireDown(f"{self.name}: not connected. Reconnect")
        if permit is not None:
            permit.check()
        self._stream.write(self._end.request(method, target, body, content_type))
        return self._count()

    def send_stop(self, method: str, target: str, body: bytes = b"") -> int:
        """Send a request now that stops the robot. It can also be sent on a connection on which malformed data was
        received, since it needs no response.

        Raises:
            WireDown: No connection is open.
        """
        self._stream.write_stop(self._end.request(method, target, body))
        return self._count()

    async def answer(self, number: int, within_s: float) -> Response:
        """Wait for the response to a request, and return it.

        If it does not come in time, the connection is closed. If the received data is no HTTP, the connection is
        kept for a stop.

        Args:
            number: The result of ``send``.
            within_s: Longest wait.

        Raises:
            WireDown: There is no response.
        """
        connection = self._stream.connection
        with trio.move_on_after(within_s):
            while self.is_open and self._stream.connection is connection and self._received < number:
                await self._hear()
            if self._stream.connection is connection and number in self._responses:
                return self._responses[number]
            raise WireDown(f"{self.name}: the connection was lost before the answer. Check the service")
        if self._stream.connection is connection:
            # A late response could be mistaken for the response to the next request.
            self.close()
        raise WireDown(f"{self.name}: no answer within {within_s * 1e3:.0f} ms. Check the service and its network")

    async def ask(
        self,
        method: str,
        target: str,
        body: bytes = b"",
        *,
        within_s: float,
        permit: Permit | None = None,
        content_type: str = JSON,
    ) -> Response:
        """Send a request and return its response. Connect first if the connection was not used within ``IDLE_S``.

        Raises:
            WireDown: There is no response within ``within_s``.
            PermitDenied: ``permit`` no longer allows this command, for example after a stop. Nothing was sent.
        """
        with trio.move_on_after(within_s) as scope:
            await self.ready()
        if not self.is_open:
            raise WireDown(f"{self.name}: no connection within {within_s * 1e3:.0f} ms. Check the service")
        number = self.send(method, target, body, permit=permit, content_type=content_type)
        return await self.answer(number, scope.deadline - trio.current_time())

    def close(self) -> None:
        """Reset the connection. A second call does nothing."""
        self._stream.close()

    def reset(self) -> None:
        """Reset the connection, and drop all requests that have not arrived, even a stop. Use it after a stop was
        confirmed on another connection."""
        self._stream.reset()

    def close_in_order(self) -> None:
        """Close the connection, but let the sent data still arrive. Use it after a stop."""
        self._stream.close(in_order=True)

    def _forget(self) -> None:
        self._end = ClientEnd(self.name, self._max_body)
        self._sent = self._received = 0  # number of requests sent, and of responses received, on this connection
        self._responses: dict[int, Response] = {}  # the newest responses, by the number of their request

    def _count(self) -> int:
        self._sent += 1
        self._used_s = trio.current_time()
        return self._sent

    async def _hear(self) -> None:
        """Receive data once. If another task receives already, wait for it. Raise ``WireDown``."""
        end, data = self._end, b""
        if end.has_unread:
            # Let other tasks run. One of them may close this connection.
            await trio.lowlevel.checkpoint()
        else:
            data = await self._stream.read()
        if end is not self._end or not (data or end.has_unread):
            return
        self._used_s = trio.current_time()
        try:
            for response in end.feed(data):
                self._received += 1
                self._responses[self._received] = response
                self._responses.pop(self._received - KEPT, None)
        except MalformedFrame as malformed:
            self._stream.deafen(str(malformed))
            raise WireDown(f"{self.name}: {malformed}. Check which service runs there") from None
