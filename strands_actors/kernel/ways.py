"""The ways by which frames travel between nodes: a link to one process, the mesh to all. Who can be
reached no longer is told without being asked for: by ``node.detach``, ``node.lost``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import msgspec

from .channels.permissions import Channel
from .messages import Message


class Way(Protocol):
    """A link or a mesh: carries frames between nodes."""

    channel: Channel | None
    """What may be said over it; None: everything."""

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        """Send without waiting; False when nobody there hosts ``to``. The sender keeps its
        descriptors, the receiver gets duplicates; a way between processes that is no link
        delivers none. ``urgent``: it may overtake what is not."""
        ...

    def send_at_once(self, data: bytes) -> bool:
        """From any thread: whole, or not at all. Only a link can, and only when nothing waits to be
        sent there."""
        ...

    def announce(self, address: str, hosted: bool) -> None: ...


class Mesh(Way, Protocol):
    def ask(
        self,
        to: str,
        sender: str,
        message: Message,
        decode: Callable[[msgspec.Raw], Message | None],
        deadline_s: float,
    ) -> Message | None:
        """Send and wait for the answer in the thread that calls."""
        ...

    def forget(self, to: str, why: str) -> None:
        """Nobody ``ask``s there any more; who waits is told why."""
        ...
