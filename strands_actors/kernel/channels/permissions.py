"""The permissions of a channel (a connection between two processes).

They limit the senders that a message may name, and the messages that each actor may receive. The receiver
identifies a sender by the channel, never by the content of a message. A process knows which process it has
started. So the parent sets the ``Channel`` at its end of the link. A message that does not match the channel is
refused before an actor reads it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from strands_actors.kernel import refusals
from strands_actors.kernel.messages import Message, Refused

MessageTypes = frozenset[type[Message]] | None
"""The permitted message types. None permits all that the actor accepts."""


class Channel(NamedTuple):
    """The permissions of one channel (a connection between two processes).

    Attributes:
        name: Written into the field ``channel`` of messages that have it. Empty for a channel with the rights
            of an operator.
        hosts: The addresses of the actors in the other process, as senders. None accepts any sender.
        nodes: The prefix of further addresses from which the other process sends requests.
        tells: The actors of this process that the other process may send to, with the permitted message types.
            None permits all.
    """

    name: str = ""
    hosts: frozenset[str] | None = None
    nodes: str = ""
    tells: Mapping[str, MessageTypes] | None = None

    def speaks_for(self, address: str) -> bool:
        return self.hosts is None or address in self.hosts or address.startswith(self.nodes)

    def refuse(self, to: str, message: Message) -> Refused | None:
        """Return a refusal if the channel may not send this message to the actor at ``to``, else None."""
        if self.tells is None:
            return None
        permitted = self.tells.get(to, frozenset())
        if permitted is None or type(message) in permitted:
            return None
        return refusals.not_permitted(to, type(message).__name__)
