"""What the wire and the stop channel of an RB-Y1 know of it."""

from __future__ import annotations

import msgspec

from strands_actors.drivers.common.addresses import parse_address

from .protocol import PORT

LATE_S = 0.5
"""An order to supplies, servos or control manager may take effect so long after it was given [assumed].
One of a client that was killed is overtaken by the root's stop, which has a connection of its own."""


class RBY1Config(msgspec.Struct, frozen=True):
    robot: str
    port: str
    axes: tuple[str, ...]
    ids: tuple[int, ...]
    priority: int
    period_s: float
    hold_s: float
    """For how long the controller holds on to a target that is not repeated."""
    silent_s: float
    """Without a state for so long the link counts as lost."""

    def address(self) -> tuple[str, int]:
        """Raise ``ValueError`` for a ``port`` that is no address."""
        return parse_address(self.port, PORT)
