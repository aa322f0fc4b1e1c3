"""The immutable settings of a legged robot. The wire process and the stop channel use the same ones."""

from __future__ import annotations

import msgspec

from .robots import Model


class UnitreeConfig(msgspec.Struct, frozen=True):
    model: Model
    port: str
    """The robot's address: ``host`` or ``host:port``."""
    interface: str = ""
    """Network interface of this computer, by name or address. Empty: the interface that leads to the robot."""
    domain: int = 0
    simulator: bool = False
    """True for Unitree's own simulator. Its states may lack a checksum and a tick, and it has no services."""
