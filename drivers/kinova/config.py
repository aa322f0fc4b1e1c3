"""What the wire and the stop channel of a Gen3 know of it."""

from __future__ import annotations

import msgspec

from strands_actors.drivers.common.addresses import parse_address

from .protocol import TCP_PORT


class KinovaConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    login: tuple[str, str]  # user and password
    axes: tuple[str, ...]
    fastest_rad_s: float
    period_s: float
    silent_s: float
    """So long without a speed that was earned, or without an answer, and the arm is stopped."""

    def address(self) -> tuple[str, int]:
        """Raise ``ValueError`` for a ``port`` that is no address."""
        return parse_address(self.port, TCP_PORT)
