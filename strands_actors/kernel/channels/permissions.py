"""Permissions of a channel: in which name it may send, and which messages to which actors.

The receiver identifies a sender by the channel, never by the content of a message. A process knows which
process it has started. So the parent sets the ``Channel`` at its end of the link. A message that does not match
it is refused before an actor reads it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.refusals import Code

Told = frozenset[type[Message]] | None
"""The permitted message types. None permits all that the actor accepts."""


class Channel(NamedTuple):
    """The permissions of one channel.

    Attributes:
        name: Written into the field ``channel`` of messages that have it. Empty for a channel with the rights
            of an operator.
        hosts: The addresses of the actors at the other end. None accepts any sender.
        nodes: The prefix of the addresses that the other node gives to the senders of asks.
        tells: The actors here that it may send to, with the permitted types. None permits all.
    """

    name: str = ""
    hosts: frozenset[str] | None = None
    nodes: str = ""
    tells: Mapping[str, Told] | None = None

    def speaks_for(self, address: str) -> bool:
        return self.hosts is None or address in self.hosts or address.startswith(self.nodes)

    def refuse(self, to: str, message: Message) -> Refused | None:
        """Return a refusal if the channel may not send this message to the actor at ``to``, else None."""
        if self.tells is None:
            return None
        kinds = self.tells.get(to, frozenset())
        if kinds is None or type(message) in kinds:
            return None
        kind = type(message).__name__
        return Refused(Code.CHANNEL, f"{to} takes no {kind} over this channel", "speak for yourself alone", kind)
