"""Open the UDP sockets of a participant. They do not block, and the kernel notes when each datagram arrives."""

from __future__ import annotations

import errno
import socket
import struct
import sys
import time

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.processes.reserve import RESERVE

from . import wire_types

_RECEIVE_BYTES = 1 << 20

# Linux reports when the kernel received a datagram. So the age includes the time that it waited in the socket.
_TIMESTAMPS = 35 if sys.platform.startswith("linux") else None  # the value of Linux's SO_TIMESTAMPNS
_TIMESPEC = struct.Struct("@qq")
ANCILLARY = socket.CMSG_SPACE(_TIMESPEC.size)
"""Room for the time stamp of a datagram."""


def is_host(text: str) -> bool:
    """Return True if the text is the IPv4 address of one host, in its usual form."""
    try:
        return socket.inet_ntoa(socket.inet_pton(socket.AF_INET, text)) == text != "0.0.0.0"
    except (OSError, ValueError):
        return False


def age_ns(timespec: bytes, longest_ns: int) -> int:
    """Return the age of a received datagram in ns, but at most ``longest_ns``.

    The kernel's time stamp is wall-clock time. If that clock was set meanwhile, the result is ``longest_ns``.
    """
    if len(timespec) != _TIMESPEC.size:
        return 0
    seconds: int
    nanoseconds: int
    seconds, nanoseconds = _TIMESPEC.unpack(timespec)
    age = time.time_ns() - seconds * 1_000_000_000 - nanoseconds
    return age if 0 <= age <= longest_ns else longest_ns


def open_sockets(domain: int, address: str, multicast: bool) -> tuple[socket.socket, ...]:
    """Open a socket for discovery, one for user data and, with ``multicast``, one for the multicast group. Raise
    ``WireDown``, without leaving a socket open."""
    opened: list[socket.socket] = []
    try:
        if multicast:
            opened.append(_group_member(domain, address))
        for index in range(wire_types.indices(domain)):
            pair = _pair(domain, address, index)
            if pair is not None:
                return (*pair, *opened)
    except OSError as error:
        RESERVE.lacked(error)
        for sock in opened:
            sock.close()
        raise WireDown(
            f"RTPS on {address}, domain {domain}: {error.strerror or error}. Check that the address is one of this "
            "host's and its interface is up"
        ) from None
    for sock in opened:
        sock.close()
    raise WireDown(f"RTPS on {address}, domain {domain}: all ports are in use. Use another address or domain")


def _pair(domain: int, address: str, index: int) -> tuple[socket.socket, socket.socket] | None:
    """Open the sockets for discovery and user data of the participant number ``index``. Return None if a port is in
    use."""
    first = _udp()
    second = _udp()
    try:
        first.bind((address, wire_types.discovery_port(domain, index)))
        second.bind((address, wire_types.user_port(domain, index)))
        first.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(address))
    except OSError as error:
        first.close()
        second.close()
        if error.errno == errno.EADDRINUSE:
            return None
        raise
    return first, second


def _group_member(domain: int, address: str) -> socket.socket:
    sock = _udp()
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if not sys.platform.startswith("linux"):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        sock.bind((wire_types.MULTICAST_GROUP, wire_types.multicast_port(domain)))
        membership = socket.inet_aton(wire_types.MULTICAST_GROUP) + socket.inet_aton(address)
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    except OSError:
        sock.close()
        raise
    return sock


def _udp() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)
    if _TIMESTAMPS is not None:
        sock.setsockopt(socket.SOL_SOCKET, _TIMESTAMPS, 1)
    return sock


def own_address(host: str) -> str:
    """Return this host's address on the route to ``host``. Raise ``ValueError``."""
    try:
        socket.inet_aton(host)
    except OSError:
        raise ValueError("port is not an IPv4 address. Give the robot's address, such as 192.168.123.161") from None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            sock.connect((host, 7400))
        except OSError as error:
            raise ValueError(
                f"there is no route to the robot ({error.strerror}). Check the network, or give network_interface="
            ) from None
        address: str = sock.getsockname()[0]
        return address
