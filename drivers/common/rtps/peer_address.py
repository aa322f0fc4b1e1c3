"""Where a participant is: a host, or one socket of it. Pure."""

from __future__ import annotations

from typing import NamedTuple

from .discovery import ParticipantData
from .wire_types import Address


class PeerAddress(NamedTuple):
    host: str
    port: int = 0  # of the socket that it announces, and speaks from; 0: any

    def holds(self, sender: Address) -> bool:
        """Return whether a datagram from ``sender`` has come from here."""
        return sender[0] == self.host and self.port in (0, sender[1])

    def has(self, data: ParticipantData, sender: Address) -> bool:
        """Return whether this participant is here: it says so, where a port tells it from its
        neighbours, and it is heard from here. What it says of itself alone is no proof."""
        return self.holds(sender) and (not self.port or tuple(self) in data.discovery)


def parse_peer_address(text: str) -> PeerAddress:
    """``host`` or ``host:port``."""
    host, _, port = text.partition(":")
    return PeerAddress(host, int(port or 0))
