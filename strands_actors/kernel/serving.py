"""Serve clients over TCP so that no client can end or block the server.

An exception in a handler ends only the connection of its client. There are few places for clients that were not
admitted (authorised) yet. When all places are taken, a new client replaces the oldest of these clients, which
is disconnected.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable

import trio

_log = logging.getLogger("strands_actors")

GONE = (OSError, trio.BrokenResourceError, trio.ClosedResourceError, trio.TooSlowError)
"""Errors of a client that disconnects or does not read."""


class Client:
    """The connection of one client. Several tasks may send; messages go out one after the other."""

    def __init__(self, stream: trio.SocketStream, send_s: float, admitted: Callable[[], object]) -> None:
        self._stream = stream
        self._send_s = send_s
        self._admitted = admitted
        self._sending = trio.Lock()

    async def receive(self, most: int) -> bytes:
        return bytes(await self._stream.receive_some(most))

    async def send(self, data: bytes) -> None:
        """Send a message. Raise ``trio.TooSlowError`` if the client does not read it."""
        with trio.fail_after(self._send_s):
            async with self._sending:
                await self._stream.send_all(data)

    def admit(self) -> None:
        """Mark the client as authorised. It no longer takes a place, so a new client cannot replace it."""
        self._admitted()


async def serve_clients(
    handler: Callable[[Client], Awaitable[None]], listener: trio.SocketListener, places: int, send_s: float
) -> None:
    """Serve until cancelled.

    Args:
        handler: The conversation with one client. An exception in it ends only that client's connection.
        listener: The socket to accept clients on.
        places: The most clients that are connected and not admitted.
        send_s: Seconds that a client may take to read a message.
    """
    # Connected clients that were not admitted yet, the oldest first.
    waiting: dict[trio.SocketStream, trio.CancelScope] = {}

    async def attend(stream: trio.SocketStream) -> None:
        scope = trio.CancelScope()

        def leave() -> None:
            waiting.pop(stream, None)

        if len(waiting) >= places:
            waiting.pop(next(iter(waiting))).cancel()
        waiting[stream] = scope
        try:
            with scope:
                async with stream:
                    await handler(Client(stream, send_s, leave))
        except* GONE:
            pass
        except* Exception as errors:
            _log.error("a client's connection was ended", exc_info=errors)
        finally:
            leave()

    await trio.serve_listeners(attend, [listener])
