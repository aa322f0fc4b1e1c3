"""Settings of a Crazyflie, shared by the process that flies it (the wire) and the supervising process (root),
which can also stop it."""

from __future__ import annotations

import re
from typing import Literal

import msgspec

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.addresses import parse_address

UDP_PORT = 19850
TCP_PORT = 5000
ACCEPTED = (
    "udp://HOST[:PORT], tcp://HOST[:PORT], serial://PATH, radio://DONGLE/CHANNEL/RATE/ADDRESS or usb://NUMBER"
)

TAKEOFF_M, TAKEOFF_S, LAND_S = 0.5, 2.0, 2.0
"""Defaults of ``takeoff`` and ``land``."""
LANDING_M_S = 0.4
"""Largest mean speed of a landing. The firmware flies from rest to rest, and in the middle 35/16 times as fast:
0.875 m/s. That is below 1.0 m/s, the most that its controller asks for (``posCtlPid.zVelMax``). At a higher speed
the drone would still be in the air when the motors go off."""

_RADIO = re.compile(r"(\d)/(\d{1,3})/(250K|1M|2M)(?:/([0-9A-Fa-f]{10}))?")
RATES = {"250K": 0, "1M": 1, "2M": 2}
DEFAULT_ADDRESS = "E7E7E7E7E7"
LAST_CHANNEL = 125


class Endpoint(msgspec.Struct, frozen=True):
    """Where a Crazyflie is reached: the parts of the option ``port``."""

    kind: Literal["udp", "tcp", "serial", "radio", "usb"]
    host: str = ""
    number: int = 0  # network port, or the index of the USB device if there are several
    path: str = ""
    channel: int = 0
    rate: int = 0
    address: bytes = b""

    @property
    def is_usb(self) -> bool:
        """Return True if the drone is reached through a USB device, a radio dongle or its own port. Only one
        process can open that device."""
        return self.kind in ("radio", "usb")


def parse_port(port: str) -> Endpoint:
    """Parse the option ``port``. Raise ``ValueError``, which lists the accepted forms."""
    scheme, separator, rest = port.partition("://")
    if not separator:
        scheme, rest = "udp", port
    match scheme:
        case "udp" | "tcp" as kind:
            host, number = parse_address(rest, UDP_PORT if kind == "udp" else TCP_PORT)
            return Endpoint(kind, host=host, number=number)
        case "serial" if rest:
            return Endpoint("serial", path=rest if rest.startswith("/") else f"/dev/{rest}")
        case "radio" if (match := _RADIO.fullmatch(rest)) and int(match[2]) <= LAST_CHANNEL:
            dongle, channel, rate, address = match.groups()
            radio_address = bytes.fromhex(address or DEFAULT_ADDRESS)
            return Endpoint(
                "radio", number=int(dongle), channel=int(channel), rate=RATES[rate], address=radio_address
            )
        case "usb" if rest.isdecimal():
            return Endpoint("usb", number=int(rest))
    raise ValueError(f"port is {port!r}. Give {ACCEPTED}")


LATE_S = 0.2
"""Longest delay of a packet behind one of the root [assumed: three repetitions by a radio, or a network of one
access point]."""


class CrazyflieConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    setpoint_hz: float
    z_m: tuple[float, float]
    battery_v: float
    climb_m_s: float
    silent_s: float = 1.0
    """The link counts as lost after so long without a report."""
    fresh_s: float = 0.5
    """Age up to which a reading counts."""

    def endpoint(self) -> Endpoint:
        """Parse the configured port. Raise ``WireDown`` if it is invalid."""
        try:
            return parse_port(self.port)
        except ValueError as error:
            raise WireDown(f"{self.robot}: {error}") from None
