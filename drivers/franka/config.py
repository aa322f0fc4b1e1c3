"""The immutable settings of a Franka arm. The wire process and the stop channel use the same ones."""

from __future__ import annotations

import msgspec

from strands_actors.drivers.common.ports.addresses import parse_address

from .arms import Arm
from .generator import Limits
from .protocol import PORT


class FrankaConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    arm: Arm
    limits: Limits
    stride: int  # number of the controller's states per reading
    speed_factor: float
    state_ttl_s: float
    gripper: str = ""  # the hand on the flange; empty without one

    @property
    def host(self) -> str:
        """The controller's host name or IP address, taken from ``port``.

        Raises:
            ValueError: ``port`` is not an address, or it contains another TCP port than 1337.
        """
        host, port = parse_address(self.port, PORT)
        if port != PORT:
            raise ValueError(f"port is {self.port!r}. Give the controller's address alone: its port is {PORT}")
        return host
