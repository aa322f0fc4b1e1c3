"""The facts about a UR arm that its wire and its stop channel need."""

from __future__ import annotations

from typing import Literal

import msgspec

from strands_actors.drivers.common.ports.addresses import parse_address

from .gates import CONTROL_HZ
from .protocol import RTDE_PORT

Way = Literal["ur-rtde", "script"]
"""The way to command a robot: ur-rtde, or our own control script."""


class URConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    silent_s: float = 0.3
    """If the controller's clock stands still for this time, the link counts as lost."""
    rtde_hz: float | None = None
    """Rate at which the controller exchanges samples and registers; None: our default."""
    control: Way | None = None
    """The way to command it. None: ur-rtde if it can be imported, else our script."""

    @property
    def samples_hz(self) -> float:
        return self.rtde_hz or CONTROL_HZ

    @property
    def host(self) -> str:
        """The host of ``port``. Raise ``ValueError`` if it is no address, or if it names another port than
        RTDE's: the ports are fixed."""
        host, port = parse_address(self.port, RTDE_PORT)
        if port != RTDE_PORT:
            raise ValueError(f"port is {self.port!r}. Give the controller's address alone: its ports are fixed")
        return host
