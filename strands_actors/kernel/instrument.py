"""The hooks by which a recorder follows the actors of a node. Without a recorder they cost one ``if`` each.

An instrument is called from within handlers, so it only stores its arguments and returns. It does not wait,
encode or raise.
"""

from __future__ import annotations

from typing import Protocol

from .messages import Message, Refused


class Instrument(Protocol):
    """The interface of a recorder, set as ``Node.instrument``.

    Addresses are those of actors of the node. Messages are frozen.
    """

    def took(self, address: str, at_ns: int, message: Message, asked: bool = False) -> None:
        """An actor begins to handle a message. Later calls for the same actor are results of it.

        Args:
            address: The actor.
            at_ns: The time that the handler sees as ``received_ns``.
            message: The message.
            asked: True if the sender waits for the answer.
        """
        ...

    def answered(self, address: str, answer: Message | None) -> None: ...

    def deferred(self, address: str, number: int) -> None:
        """The actor answers later, by ``settled`` with this number."""
        ...

    def settled(self, address: str, number: int, answer: Message | None) -> None: ...

    def sent(self, sender: str, to: str, message: Message) -> None:
        """An actor sent a message by ``tell``. (An ask is made by a task next to the actor, not by its
        handler.)"""
        ...

    def saw(self, address: str, value: object) -> None:
        """A handler has read a value from outside of its message, or written one."""
        ...

    def refused(self, to: str, what: str, refusal: Refused) -> None:
        """The kernel refused a message before the actor could read it. ``what`` is the name of its type."""
        ...

    def noted(self, address: str, at_ns: int, message: Message) -> None:
        """An event without a message."""
        ...
