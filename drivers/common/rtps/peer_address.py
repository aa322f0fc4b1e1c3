"""The address of a participant: a host, or one UDP port of a host. Pure."""

from __future__ import annotations

from typing import NamedTuple

from .discovery import ParticipantData
from .wire_types import Address


class PeerAddress(NamedTuple):
    host: str
    port: int = 0  # UDP port that the participant announces and sends from; 0 accepts any port

    def holds(self, sender: Address) -> bool:
        """Return True if ``sender`` matches this address."""
        return sender[0] == self.host and self.port in (0, sender[1])

    def has(self, data: ParticipantData, sender: Address) -> bool:
        """Return True if the participant that has announced ``data`` in a datagram from ``sender`` has this
        address.

        The datagram must come from this address, because the announcement alone proves nothing. If this address
        has a port, the participant must also have announced this port, because several participants can run on one
        host.
        """
        return self.holds(sender) and (not self.port or tuple(self) in data.discovery)


def parse_peer_address(text: str) -> PeerAddress:
    """Parse ``host`` or ``host:port``."""
    host, _, port = text.partition(":")
    return PeerAddress(host, int(port or 0))
