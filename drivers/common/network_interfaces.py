"""This host's network interfaces, by their names."""

from __future__ import annotations

import fcntl
import socket
import struct
import sys
from typing import Annotated

from strands_actors.contract.options import option

_GET_ADDRESS = 0x8915 if sys.platform.startswith("linux") else 0xC0206921
"""SIOCGIFADDR: of Linux; of macOS and the BSDs."""
_REQUEST = struct.Struct("16s16s")
_ADDRESS = slice(20, 24)
"""Of the answer: a name of 16 bytes, then a socket address with two bytes of family and two of
port."""


NetworkInterface = Annotated[
    str,
    option(
        "this host's interface on the robot's network, by name (eth0) or IPv4 address; "
        "empty: the one that leads to it",
        pattern=r"^[A-Za-z0-9_.:@-]{0,15}\Z",
    ),
]
"""The option itself, of every driver whose robot is found on a network."""


def address_of(interface: str) -> str:
    """Return the IPv4 address of an interface; an address is returned as it is. Raise
    ``ValueError`` with the interfaces that there are."""
    try:
        return socket.inet_ntoa(socket.inet_pton(socket.AF_INET, interface))
    except OSError:
        pass  # a name
    known = ", ".join(name for _, name in socket.if_nameindex())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            answer = fcntl.ioctl(sock, _GET_ADDRESS, _REQUEST.pack(interface.encode()[:15], b""))
        except OSError as error:
            raise ValueError(
                f"network_interface is {interface!r} ({error.strerror}). This host has {known}; "
                "the one on the robot's network needs an IPv4 address"
            ) from None
    return socket.inet_ntoa(answer[_ADDRESS])
