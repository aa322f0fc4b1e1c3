"""The kind of a connection to a robot. A report of a drill has the kind, and never the port or address."""

from __future__ import annotations

import enum
import ipaddress
import os
import re
import socket
import stat


class Connection(enum.StrEnum):
    """The kind of a connection."""

    TWIN = "twin"  # to the robot's twin, which the drill has started
    SERIAL = "serial port"
    PSEUDO_TERMINAL = "pseudo terminal"
    UNIX_SOCKET = "unix socket"
    LOOPBACK = "loopback address"
    NETWORK = "network"
    INTERFACE = "network interface"
    RADIO = "radio"
    USB = "usb"
    SSH = "ssh"
    DEFAULT = "default"  # the port was left out, because the driver has a default


ON_THIS_COMPUTER = frozenset({Connection.PSEUDO_TERMINAL, Connection.UNIX_SOCKET, Connection.LOOPBACK})
"""Connections to another program of the same computer, such as a twin that the user has started."""

_SCHEME = re.compile(r"([a-z][a-z0-9+.-]*)://(.*)", re.IGNORECASE)
_BY_SCHEME = {"radio": Connection.RADIO, "usb": Connection.USB, "ssh": Connection.SSH}


def connection_of(port: str) -> Connection:
    """Return the kind of the connection to a robot.

    Args:
        port: The port or address, in the form of the argument of ``Robot``. Nothing is opened.
    """
    if not port:
        return Connection.DEFAULT
    scheme, rest = match.groups() if (match := _SCHEME.fullmatch(port)) else ("", port)
    if rest.startswith("/"):
        return _of_path(rest)
    if _is_loopback(rest):
        return Connection.LOOPBACK
    if scheme:
        return _BY_SCHEME.get(scheme.lower(), Connection.NETWORK)
    return Connection.INTERFACE if rest in _interfaces() else Connection.NETWORK


def _of_path(path: str) -> Connection:
    real = os.path.realpath(path)
    if real.startswith("/dev/pts/"):
        return Connection.PSEUDO_TERMINAL
    try:
        is_socket = stat.S_ISSOCK(os.stat(real).st_mode)
    except OSError:
        is_socket = False
    return Connection.UNIX_SOCKET if is_socket else Connection.SERIAL


def _is_loopback(address: str) -> bool:
    """Return True for an address of this computer, with or without a user, a port and a path."""
    place = address.partition("/")[0].rpartition("@")[2]
    host = place.removeprefix("[").partition("]")[0] if place.startswith("[") else place
    if host.count(":") == 1:
        host = host.partition(":")[0]
    if host.lower() in ("localhost", "lo"):
        return True
    try:
        parsed = ipaddress.ip_address(host)
    except ValueError:
        return False
    return parsed.is_loopback or parsed.is_unspecified


def _interfaces() -> set[str]:
    return {name for _, name in socket.if_nameindex()}
