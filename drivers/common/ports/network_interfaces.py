"""The network interfaces of this host, by name."""

from __future__ import annotations

import fcntl
import socket
import struct
import sys
from typing import Annotated

from strands_actors.contract.options import option

_GET_ADDRESS = 0x8915 if sys.platform.startswith("linux") else 0xC0206921
"""SIOCGIFADDR: on Linux, otherwise on macOS and the BSDs."""
_REQUEST = struct.Struct("16s16s")
_ADDRESS = slice(20, 24)
"""Place of the address in the answer, after a name of 16 bytes, two bytes of family and two of port."""


NetworkInterface = Annotated[
    str,
    option(
        "this host's interface on the robot's network, by name (eth0) or IPv4 address; "
        "empty: the one that leads to it",
        pattern=r"^[A-Za-z0-9_.:@-]{0,15}\Z",
    ),
]
"""The option of every driver that finds its robot on a network."""


def address_of(interface: str) -> str:
    """Return the IPv4 address of a network interface. If an address is given, return it unchanged.

    Raises:
        ValueError: There is no such interface. The exception's text lists the existing ones.
    """
    try:
        return socket.inet_ntoa(socket.inet_pton(socket.AF_INET, interface))
    except OSError:
        # The text is not an address, so it is the name of an interface.
        pass
    names = ", ".join(name for _, name in socket.if_nameindex())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            answer = fcntl.ioctl(sock, _GET_ADDRESS, _REQUEST.pack(interface.encode()[:15], b""))
        except OSError as error:
            raise ValueError(
                f"network_interface is {interface!r} ({error.strerror}). This host has {names}. "
                "Give the one on the robot's network, which needs an IPv4 address"
            ) from None
    return socket.inet_ntoa(answer[_ADDRESS])
