"""What the wire and the stop channel of a rover know of it."""

from __future__ import annotations

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.http_port import HttpPort
from strands_actors.drivers.common.tcp_port import parse_address

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
        scheme, found, rest = self.port.partition("://")
        if not found:
            scheme, rest = "http", self.port
        rest = rest.removesuffix("/")
        if scheme != "http" or not rest or any(sign in rest for sign in "/?#@ "):
            raise ValueError(
                f"port is {self.port!r}. Give the address of the SDK process: 192.0.2.10:{PORT} or "
                f"http://192.0.2.10:{PORT}, without a user or a path. It speaks no https"
            )
        return parse_address(rest, PORT)

    def open_port(self) -> HttpPort:
        """Return a port to the service, not yet connected. Raise ``WireDown`` for an address that
        is none."""
        try:
            return HttpPort(*self.address())
        except ValueError as error:
            raise WireDown(str(error)) from None
