"""What may be said over one way between processes: in whose name, and what to whom.

Who speaks is known by the channel it speaks on, never by what it says. A process that starts
another knows what it has started; so the channel is given to the parent's end of a link, and what
does not fit it is refused before an actor reads it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.refusals import Code

Told = frozenset[type[Message]] | None
"""Which messages; None: every one that the actor takes."""


class Channel(NamedTuple):
    """``name``: what messages with a field ``channel`` are stamped with; empty for who may do what
    an operator may. ``hosts``: the actors that live at the other end, None: anybody. ``nodes``: how
    addresses begin that its node gives to who asks. ``tells``: the actors here that it may speak
    to; None: all."""

    name: str = ""
    hosts: frozenset[str] | None = None
    nodes: str = ""
    tells: Mapping[str, Told] | None = None

    def speaks_for(self, address: str) -> bool:
        return self.hosts is None or address in self.hosts or address.startswith(self.nodes)

    def refuse(self, to: str, message: Message) -> Refused | None:
        """None when it may say this to the actor at ``to``."""
        if self.tells is None:
            return None
        kinds = self.tells.get(to, frozenset())
        if kinds is None or type(message) in kinds:
            return None
        kind = type(message).__name__
        return Refused(Code.CHANNEL, f"{to} takes no {kind} over this channel", "speak for yourself alone", kind)
