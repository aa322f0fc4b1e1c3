"""The connections over which frames travel between nodes: a link to one process, or the mesh to all.

A connection reports nodes that it can no longer reach by calling ``node.detach`` (a link) or ``node.lost`` (a
mesh).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import msgspec

from .channels.permissions import Channel
from .messages import Message


class Connection(Protocol):
    """A carrier of frames between nodes: a link or a mesh."""

    channel: Channel | None
    """The messages that are accepted from this connection. None accepts all."""

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        """Send a frame without waiting.

        Args:
            to: The address of the receiver.
            data: The frame.
            descriptors: Open files that are sent with the frame. The sender keeps its own, and the receiver
                gets duplicates. Only a link delivers descriptors to another process.
            urgent: The frame may overtake frames that are not urgent.

        Returns:
            False if no process there hosts ``to``.
        """
        ...

    def send_at_once(self, data: bytes) -> bool:
        """Send a whole frame from any thread, or nothing. Return True if it was sent.

        Only a link can do this, and only when it has no other frames to send.
        """
        ...

    def announce(self, address: str, hosted: bool) -> None: ...


class Mesh(Connection, Protocol):
    def ask(
        self,
        to: str,
        sender: str,
        message: Message,
        decode: Callable[[msgspec.Raw], Message | None],
        deadline_s: float,
    ) -> Message | None:
        """Send a request and wait for the answer in the calling thread."""
        ...

    def forget(self, to: str, reason: str) -> None:
        """End all requests of ``ask`` to this address. The waiting threads get an error with the text
        ``reason``.
        """
        ...
