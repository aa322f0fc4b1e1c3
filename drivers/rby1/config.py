"""Settings of an RB-Y1, shared by the process that drives it (the wire) and the supervising process
(root), which can also stop it."""

from __future__ import annotations

import msgspec

from strands_actors.drivers.common.ports.addresses import parse_address

from .protocol import PORT

LATE_S = 0.5
"""An order to supplies, servos or control manager may take effect this long after it was sent
[assumed]. The stop of the root uses a separate connection, so it can overtake the order of a killed
client."""


class RBY1Config(msgspec.Struct, frozen=True):
    robot: str
    port: str
    axes: tuple[str, ...]
    ids: tuple[int, ...]
    priority: int
    period_s: float
    hold_s: float
    """How long the controller holds a target that is not repeated."""
    silent_s: float
    """The link counts as lost after this long without a state."""

    def address(self) -> tuple[str, int]:
        """Parse the configured port into host and port number. Raise ``ValueError`` if it is not an
        address."""
        return parse_address(self.port, PORT)
