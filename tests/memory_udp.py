"""Simulate UDP in memory: sockets for participants of DDS in place of the system's.

A subclass of ``MemoryNetwork`` decides what happens to a datagram on its way. That of the explorer
loses and delays datagrams; that of the hostile peers changes them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import trio

Address = tuple[str, int]

ROOM = 512
"""How many datagrams a socket keeps for a process that does not read [assumed: 1 MB]."""


class Datagram(NamedTuple):
    """One datagram.

    Attributes:
        left_s: When it was sent, in seconds of trio's clock.
        role: The role of the sending process; empty for the robot.
        sender: The address of its socket.
        data: The content.
    """

    left_s: float
    role: str
    sender: Address
    data: bytes


class MemoryNetwork(ABC):
    """The network, with all open sockets."""

    def __init__(self, ports: Callable[[int, int], tuple[int, int]]) -> None:
        """Make a network.

        Args:
            ports: From domain and index of a participant, its ports for discovery and for data.
        """
        self.sockets: dict[Address, MemorySocket] = {}
        self._ports = ports

    def open_sockets(self, domain: int, host: str, multicast: bool) -> tuple[MemorySocket, ...]:
        """Open the sockets of a participant, as ``rtps.sockets.open_sockets`` does, but without
        multicast."""
        index = 0
        while any((host, port) in self.sockets for port in self._ports(domain, index)):
            index += 1
        return tuple(self.make_socket((host, port)) for port in self._ports(domain, index))

    @abstractmethod
    def make_socket(self, address: Address) -> MemorySocket: ...

    @abstractmethod
    def send(self, datagram: Datagram, to: Address) -> None: ...

    def arrive(self, datagram: Datagram, to: Address) -> None:
        sock = self.sockets.get(to)
        if sock is not None:
            sock.arrived(datagram)


class MemorySocket:
    """The methods of a socket that a participant uses, and ``readable`` for ``trio.lowlevel``."""

    def __init__(self, network: MemoryNetwork, address: Address) -> None:
        self.network: Any = network
        self.address = address
        self.newest: Datagram | None = None
        """The datagram that was read last."""
        self.on_arrival: Callable[[], None] | None = None
        """Called for each datagram, for a robot that has no loop."""
        self._waiting: deque[Datagram] = deque()
        self._news: trio.Event | None = None
        network.sockets[address] = self

    def sendmsg(self, parts: Sequence[Any], ancillary: object, flags: int, address: Address) -> int:
        data = b"".join(parts)
        self.network.send(Datagram(trio.current_time(), "", self.address, data), address)
        return len(data)

    def recvmsg_into(self, buffers: Sequence[bytearray], room: int) -> tuple[int, list[Any], int, Address]:
        if not self._waiting:
            raise BlockingIOError
        datagram = self.newest = self._waiting.popleft()
        return put_into(buffers[0], datagram.data), [], 0, datagram.sender

    def getsockname(self) -> Address:
        return self.address

    def arrived(self, datagram: Datagram) -> None:
        if len(self._waiting) < ROOM:
            self._waiting.append(datagram)
        if self.on_arrival is not None:
            self.on_arrival()
        elif self._news is not None:
            self.tell()

    def tell(self) -> None:
        """Wake the reader. A subclass may do so later."""
        self.rouse()

    async def readable(self) -> None:
        """Wait as ``trio.lowlevel.wait_readable`` does."""
        await trio.lowlevel.checkpoint()
        if not self._waiting:
            self._news = trio.Event()
            await self._news.wait()
            self._news = None

    def rouse(self) -> None:
        if self._news is not None:
            self._news.set()

    def close(self) -> None:
        if self.network.sockets.get(self.address) is self:
            del self.network.sockets[self.address]
        self._waiting.clear()


def put_into(buffer: bytearray, data: bytes) -> int:
    """Copy a datagram into the buffer, and return how many bytes fitted."""
    size = min(len(buffer), len(data))
    buffer[:size] = data[:size]
    return size
