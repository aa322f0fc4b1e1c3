"""The hooks by which a recorder follows the actors of a node. Without a recorder each hook costs one ``if``.

A recorder is called from within handlers, so it only stores its arguments and returns. It does not wait, encode
or raise.
"""

from __future__ import annotations

from typing import Protocol

from .messages import Message, Refused


class Instrument(Protocol):
    """The interface of a recorder, set as ``Node.instrument``.

    Addresses are those of actors of the node. Messages are immutable objects.
    """

    def took(self, address: str, at_ns: int, message: Message, expects_answer: bool = False) -> None:
        """An actor begins to handle a message. Later calls for the same actor report the results of this
        message.

        Args:
            address: The actor.
            at_ns: The time that the handler sees as ``received_ns``.
            message: The message.
            expects_answer: True if the sender waits for the answer.
        """
        ...

    def answered(self, address: str, answer: Message | None) -> None: ...

    def deferred(self, address: str, number: int) -> None:
        """The actor answers the message later. ``settled`` then reports the answer, with the same number."""
        ...

    def settled(self, address: str, number: int, answer: Message | None) -> None: ...

    def sent(self, sender: str, to: str, message: Message) -> None:
        """An actor has sent a message by ``tell``.

        (A request by ``ask`` is sent by a task next to the actor, not by its handler.)
        """
        ...

    def saw(self, address: str, value: object) -> None:
        """Record a value that a handler has read or written and that is not in its message. A replay needs it."""
        ...

    def refused(self, to: str, message_type: str, refusal: Refused) -> None:
        """The kernel refused a message before the actor could read it. ``message_type`` is the name of its type."""
        ...

    def noted(self, address: str, at_ns: int, message: Message) -> None:
        """An event has happened that no message describes."""
        ...
