"""Serving clients over TCP so that none of them can end or block the server.

A client's connection ends by itself whatever happens on it: what a handler raises is contained. Who has
not shown yet that it may speak holds one of few places, and the oldest of them gives way to a new one.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable

import trio

_log = logging.getLogger("strands_actors")

GONE = (OSError, trio.BrokenResourceError, trio.ClosedResourceError, trio.TooSlowError)
"""What a client does that goes away, or does not read."""


class Client:
    """One client's connection. Several tasks may send: one message goes out after the other."""

    def __init__(self, stream: trio.SocketStream, send_s: float, admitted: Callable[[], object]) -> None:
        self._stream = stream
        self._send_s = send_s
        self._admitted = admitted
        self._sending = trio.Lock()

    async def receive(self, most: int) -> bytes:
        return bytes(await self._stream.receive_some(most))

    async def send(self, data: bytes) -> None:
        """Raise ``trio.TooSlowError`` for a client that does not read."""
        with trio.fail_after(self._send_s):
            async with self._sending:
                await self._stream.send_all(data)

    def admit(self) -> None:
        """It has shown that it may speak: it gives way to nobody any more."""
        self._admitted()


async def serve_clients(
    handler: Callable[[Client], Awaitable[None]], listener: trio.SocketListener, places: int, send_s: float
) -> None:
    """Serve until cancelled.

    Args:
        handler: One client's conversation. What it raises ends that client's connection alone.
        places: How many clients may be connected that were not admitted.
        send_s: How long a client may take to read a message.
    """
    waiting: dict[trio.SocketStream, trio.CancelScope] = {}  # the oldest first

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
