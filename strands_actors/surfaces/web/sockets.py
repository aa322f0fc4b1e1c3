"""What the WebSockets of all pages share."""

from __future__ import annotations

import trio
from starlette.websockets import WebSocket, WebSocketDisconnect

SEND_S = 5.0
"""A page that has not read a message after this time is disconnected."""
LONGEST_MS = 1e12
"""Greatest time of a page's clock (about 30 years)."""
BAD_MESSAGE = 1003
"""Code with which the connection of a page that sends something else is closed (RFC 6455, 7.4.1)."""
ENDED = 1008
"""The same after the end of the session."""
DISCONNECTED = (WebSocketDisconnect, trio.TooSlowError, RuntimeError)
"""The page has disconnected, or reads nothing. Starlette raises RuntimeError if it disconnects while a message is
sent."""


async def send(socket: WebSocket, text: str, within_s: float = SEND_S) -> None:
    """Send a message.

    Raises:
        trio.TooSlowError: The page has not read it in time.
    """
    with trio.fail_after(within_s):
        await socket.send_text(text)
