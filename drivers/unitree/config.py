"""The facts about a legged robot that its wire and its stop channel need."""

from __future__ import annotations

import msgspec

from .robots import Model


class UnitreeConfig(msgspec.Struct, frozen=True):
    model: Model
    port: str
    """The robot's address: ``host`` or ``host:port``."""
    interface: str = ""
    """Our network interface, by name or address; empty for the one that leads to the robot."""
    domain: int = 0
    simulator: bool = False
    """True for Unitree's own simulator. Its states may lack a checksum and a tick, and it has no services."""
