"""What the wire and the stop channel of a legged robot know of it."""

from __future__ import annotations

import msgspec

from .robots import Model


class UnitreeConfig(msgspec.Struct, frozen=True):
    model: Model
    port: str
    """The robot's address: ``host`` or ``host:port``."""
    interface: str = ""
    """Ours on its network, by name or address; empty: the one that leads there."""
    domain: int = 0
    simulator: bool = False
    """Unitree's own: its states may have neither checksum nor tick, and it has no services."""
