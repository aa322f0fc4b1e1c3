"""What the wire and the stop channel of a rover know of it."""

from __future__ import annotations

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.addresses import parse_web_address
from strands_actors.drivers.common.http_port import HttpPort

from .protocol import PORT

REPORT_OLD_S = 2.0
"""A report whose stamp is older is no report. Rows in the vendor's example of one span about a
second: so rarely a rover may report, and the service tells the last report until the next
[assumed]."""


class EarthRoverConfig(msgspec.Struct, frozen=True):
    port: str
    axes: tuple[Axis, ...]
    timeout_s: float
    control_hz: float

    def address(self) -> tuple[str, int]:
        """Return host and port. Raise ``ValueError`` for a ``port`` that is no address of a
        service."""
        return parse_web_address(self.port, PORT, "the SDK process")

    def open_port(self) -> HttpPort:
        """Return a port to the service, not yet connected. Raise ``WireDown`` for an address that
        is none."""
        try:
            return HttpPort(*self.address())
        except ValueError as error:
            raise WireDown(str(error)) from None
