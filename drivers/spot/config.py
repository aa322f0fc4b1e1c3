"""Settings of a Spot, shared by the process that drives it (the wire) and the supervising process (root), which
can also stop it."""

from __future__ import annotations

import importlib.util
import os
import ssl
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.addresses import parse_address

from .protocol import PORT

INSTALL = "Install it: pip install 'strands-actors[spot]'"
USERNAME, PASSWORD = "BOSDYN_CLIENT_USERNAME", "BOSDYN_CLIENT_PASSWORD"
TWIN_LOGIN = "twin", "twin"
"""The login at a twin by default. It is also the default of the twin's options ``user`` and ``password``."""

SAFE_S = 8.0
"""Longest duration of ``make_safe``: the robot sits, or its e-stop is asserted. For the stop channel it
includes the start of a process and two answers."""

LATE_S = 0.5
"""Time after which the robot reports the effect of a power command or a stand [assumed]. A later one is
refused: its lease is older than that of a stop, or the e-stop is asserted."""

_CA = "?ca="


class Address(NamedTuple):
    host: str
    port: int
    ca: str
    """Path of the trusted certificates; empty for the vendor's."""


def parse_port(port: str) -> Address:
    """Parse ``HOST[:PORT][?ca=PATH]``. Raise ``ValueError``, which shows the accepted form."""
    address_text, has_ca, path = port.partition(_CA)
    if has_ca and not path:
        raise ValueError(f"port is {port!r}. Give the path of a certificate file after ?ca=")
    return Address(*parse_address(address_text, PORT), path)


def vendor_certificate() -> str:
    """Return the path of the root certificate that has signed the certificate of every Spot.

    The file is part of the vendor's client. The client itself is not imported.

    Raises:
        WireDown: The client is not installed. The message contains the command that installs it.
    """
    try:
        client = importlib.util.find_spec("bosdyn.client")
    except ImportError:
        client = None
    path = Path(client.origin).parent / "resources" / "robot.pem" if client and client.origin else None
    if path is None or not path.is_file():
        raise WireDown(f"bosdyn-client, which contains Boston Dynamics' certificate, is missing. {INSTALL}")
    return str(path)


class SpotConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    axes: tuple[Axis, ...]
    estop_timeout_s: float
    arm_speed_rad_s: float
    feed_s: float = 0.1
    """Period in which ``SpotWire.feed`` is called."""
    silent_s: float = 1.0
    """The link counts as lost after so long without an answer."""

    def address(self) -> Address:
        """Parse the configured port. Raise ``WireDown`` if it is invalid."""
        try:
            return parse_port(self.port)
        except ValueError as error:
            raise WireDown(f"{self.robot}: {error}") from None

    def tls(self) -> ssl.SSLContext:
        """Return the TLS context of a connection. Raise ``WireDown`` without certificates."""
        path = self.address().ca or vendor_certificate()
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.set_alpn_protocols(["h2"])
        try:
            context.load_verify_locations(path)
        except (OSError, ssl.SSLError) as error:
            raise WireDown(f"{self.robot}: no certificates in {path} ({error})") from None
        return context

    def login(self, environment: Mapping[str, str] = os.environ) -> tuple[str, str]:
        """Return user and password from the environment. Raise ``WireDown`` if they are missing."""
        user, password = environment.get(USERNAME, ""), environment.get(PASSWORD, "")
        if user and password:
            return user, password
        if self.address().ca:
            return TWIN_LOGIN
        missing = " and ".join(name for name, value in ((USERNAME, user), (PASSWORD, password)) if not value)
        raise WireDown(f"{self.robot}: no login. Set {missing} in the environment")
