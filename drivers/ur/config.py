"""What the wire and the stop channel of a UR arm know of it."""

from __future__ import annotations

from typing import Literal

import msgspec

from strands_actors.drivers.common.addresses import parse_address

from .gates import CONTROL_HZ
from .protocol import RTDE_PORT

Way = Literal["ur-rtde", "script"]
"""How a robot is commanded: by ur-rtde, or by our own control script."""


class URConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    silent_s: float = 0.3
    """When the controller's clock stands still for so long the link counts as lost."""
    rtde_hz: float | None = None
    """Rate at which the controller exchanges samples and registers; None: ours."""
    control: Way | None = None
    """Way to command it. None: ur-rtde where it can be imported, else our script."""

    @property
    def samples_hz(self) -> float:
        return self.rtde_hz or CONTROL_HZ

    @property
    def host(self) -> str:
        """Raise ``ValueError`` for a ``port`` that is no address, or names a port: those are
        fixed."""
        host, port = parse_address(self.port, RTDE_PORT)
        if port != RTDE_PORT:
            raise ValueError(f"port is {self.port!r}. Give the controller's address alone: its ports are fixed")
        return host
