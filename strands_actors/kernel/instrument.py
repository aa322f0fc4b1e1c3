"""What a recorder is told of the actors of a node. While there is none, all it costs is an ``if``.

An instrument is called from inside the handlers: it notes and returns. It does not wait, encode or
raise.
"""

from __future__ import annotations

from typing import Protocol

from .messages import Message, Refused


class Instrument(Protocol):
    """Set as ``Node.instrument``. Addresses are those of actors of the node, messages are
    frozen."""

    def took(self, address: str, at_ns: int, message: Message, asked: bool = False) -> None:
        """An actor takes a message up; what follows of the same actor is what it makes of it.
        ``asked``: somebody waits for the answer."""
        ...

    def answered(self, address: str, answer: Message | None) -> None: ...

    def deferred(self, address: str, number: int) -> None:
        """Instead of an answer: it comes later, as ``settled`` with this number."""
        ...

    def settled(self, address: str, number: int, answer: Message | None) -> None: ...

    def sent(self, sender: str, to: str, message: Message) -> None:
        """A tell. (An ask is made by a task beside the actor, not by its handler.)"""
        ...

    def saw(self, address: str, value: object) -> None:
        """What a handler has read of the world beside its message, or written into it."""
        ...

    def refused(self, to: str, what: str, refusal: Refused) -> None:
        """The kernel refused a message (by its type's name) before the actor could read it."""
        ...

    def noted(self, address: str, at_ns: int, message: Message) -> None:
        """An event that no message tells."""
        ...
