"""The settings that the wire process and the root's stop channel of a rover share."""

from __future__ import annotations

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.addresses import parse_web_address
from strands_actors.drivers.common.ports.http_port import HttpPort

from .protocol import PORT

REPORT_OLD_S = 2.0
"""A report that arrived longer ago than this is not used, in seconds. In the vendor's example the rows of one
report span about a second. So a rover may report only once a second, and the service repeats the last report
until the next one [assumed]."""


class EarthRoverConfig(msgspec.Struct, frozen=True):
    port: str
    axes: tuple[Axis, ...]
    timeout_s: float
    control_hz: float

    def address(self) -> tuple[str, int]:
        """Return host and port. Raise ``ValueError`` for an invalid ``port``."""
        return parse_web_address(self.port, PORT, "the SDK process")

    def open_port(self) -> HttpPort:
        """Return an HTTP connection that is not open yet. Raise ``WireDown`` for an invalid address."""
        try:
            return HttpPort(*self.address())
        except ValueError as error:
            raise WireDown(str(error)) from None
