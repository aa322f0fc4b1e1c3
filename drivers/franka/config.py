"""What the wire and the stop channel of a Franka arm know of it."""

from __future__ import annotations

import msgspec

from strands_actors.drivers.common.addresses import parse_address

from .arms import Arm
from .generator import Limits
from .protocol import PORT


class FrankaConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    arm: Arm
    limits: Limits
    stride: int  # how many of the controller's states make one reading
    speed_factor: float
    state_ttl_s: float

    @property
    def host(self) -> str:
        """Raise ``ValueError`` for a ``port`` that is no address, or names a port: that is
        fixed."""
        host, port = parse_address(self.port, PORT)
        if port != PORT:
            raise ValueError(f"port is {self.port!r}. Give the controller's address alone: its port is {PORT}")
        return host
