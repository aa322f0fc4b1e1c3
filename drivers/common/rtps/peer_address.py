"""The place of a participant: a host, or one socket of a host. Pure."""

from __future__ import annotations

from typing import NamedTuple

from .discovery import ParticipantData
from .wire_types import Address


class PeerAddress(NamedTuple):
    host: str
    port: int = 0  # of the socket that it announces and sends from; 0 means any

    def holds(self, sender: Address) -> bool:
        """Return whether a datagram from ``sender`` comes from this place."""
        return sender[0] == self.host and self.port in (0, sender[1])

    def has(self, data: ParticipantData, sender: Address) -> bool:
        """Return whether a participant is at this place.

        Its datagram must come from here, because its own data are no proof. If this place has a
        port, the participant must announce it too, since several can run on one host.
        """
        return self.holds(sender) and (not self.port or tuple(self) in data.discovery)


def parse_peer_address(text: str) -> PeerAddress:
    """Parse ``host`` or ``host:port``."""
    host, _, port = text.partition(":")
    return PeerAddress(host, int(port or 0))
