"""What the wire and the stop channel of a Crazyflie know of it."""

from __future__ import annotations

import re
from typing import Literal

import msgspec

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.addresses import parse_address

UDP_PORT = 19850
TCP_PORT = 5000
ACCEPTED = (
    "udp://HOST[:PORT], tcp://HOST[:PORT], serial://PATH, radio://DONGLE/CHANNEL/RATE/ADDRESS or usb://NUMBER"
)

TAKEOFF_M, TAKEOFF_S, LAND_S = 0.5, 2.0, 2.0
"""Of ``takeoff`` and ``land``, where they are not told otherwise."""
LANDING_M_S = 0.4
"""Mean speed of a landing, of none is it more. The firmware flies from rest to rest, in the middle 35/16
times as fast: 0.875 m/s, which stays below the 1.0 m/s that its controller asks for at most
(``posCtlPid.zVelMax``). Faster, and the drone is still in the air when the motors go off."""

_RADIO = re.compile(r"(\d)/(\d{1,3})/(250K|1M|2M)(?:/([0-9A-Fa-f]{10}))?")
RATES = {"250K": 0, "1M": 1, "2M": 2}
DEFAULT_ADDRESS = "E7E7E7E7E7"
LAST_CHANNEL = 125


class Endpoint(msgspec.Struct, frozen=True):
    """Where a Crazyflie is: a ``port`` that was parsed."""

    kind: Literal["udp", "tcp", "serial", "radio", "usb"]
    host: str = ""
    number: int = 0  # port; dongle or drone, where there are several
    path: str = ""
    channel: int = 0
    rate: int = 0
    address: bytes = b""

    @property
    def is_usb(self) -> bool:
        """Whether it is reached by a USB device: only one process can have that."""
        return self.kind in ("radio", "usb")


def parse_port(port: str) -> Endpoint:
    """Raise ``ValueError`` with what would be accepted."""
    scheme, found, rest = port.partition("://")
    if not found:
        scheme, rest = "udp", port
    match scheme:
        case "udp" | "tcp" as kind:
            host, number = parse_address(rest, UDP_PORT if kind == "udp" else TCP_PORT)
            return Endpoint(kind, host=host, number=number)
        case "serial" if rest:
            return Endpoint("serial", path=rest if rest.startswith("/") else f"/dev/{rest}")
        case "radio" if (match := _RADIO.fullmatch(rest)) and int(match[2]) <= LAST_CHANNEL:
            dongle, channel, rate, address = match.groups()
            where = bytes.fromhex(address or DEFAULT_ADDRESS)
            return Endpoint("radio", number=int(dongle), channel=int(channel), rate=RATES[rate], address=where)
        case "usb" if rest.isdecimal():
            return Endpoint("usb", number=int(rest))
    raise ValueError(f"port is {port!r}. Give {ACCEPTED}")


LATE_S = 0.2
"""A packet that was sent may arrive so late, behind one of the root [assumed: three repetitions by a radio,
or a network of one access point]."""


class CrazyflieConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    setpoint_hz: float
    z_m: tuple[float, float]
    battery_v: float
    climb_m_s: float
    silent_s: float = 1.0
    """Without a row of the log for so long the link counts as lost."""
    fresh_s: float = 0.5
    """What was read is believed for so long."""

    def endpoint(self) -> Endpoint:
        """Raise ``WireDown`` for a port that is none."""
        try:
            return parse_port(self.port)
        except ValueError as error:
            raise WireDown(f"{self.robot}: {error}") from None
