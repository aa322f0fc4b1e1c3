"""Simulate the sockets below ``UdpPort`` and ``UdpListener``, between the processes of a tree and one robot.

A descriptor is real (of an empty file in memory), so that the code that duplicates, sends and closes it runs
unchanged. Duplicates of one descriptor read from one queue, so each datagram is read once.
"""

from __future__ import annotations

import errno
import itertools
import os
from collections.abc import Callable
from typing import Any, ClassVar, cast

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.udp_port import UdpListener, UdpPort
from tests.memory_udp import ROOM, Address, Datagram, MemorySocket

from .exhaustion import open_file
from .tcp_network import OURS
from .udp_network import UdpNetwork
from .world import Process, World

FIRST_PORT = 40_000
"""First port of the sockets that are bound to none."""


class DatagramNetwork(UdpNetwork):
    """The network of one robot, at ``address``.

    Attributes:
        SOCKET: The type of its sockets.
    """

    SOCKET: ClassVar[type[DatagramSocket]]

    def __init__(
        self,
        world: World,
        address: Address,
        take: Callable[[Datagram], None],
        sent: Callable[[Datagram], None],
    ) -> None:
        """Make a network.

        Args:
            take: Called with each datagram that arrives at the robot.
            sent: Called with each datagram that a process sends.
        """
        super().__init__(world, address[0], lambda *_: (0, 0))
        self.address = address
        self.sent = sent
        _RobotSocket(self, address, take)
        self._free_ports = itertools.count(FIRST_PORT)
        self._bound: dict[int, _Bound] = {}  # by inode

    def open_udp(self, host: str, port: int) -> UdpPort:
        """As the function of this name in ``udp_port``."""
        return UdpPort(self.open_udp_socket(), f"{host}:{port}")

    def open_udp_socket(self) -> Any:
        return self._open(next(self._free_ports))

    async def listen_udp(self, port: int, host: str = "") -> UdpListener:
        """As the function of this name in ``udp_port``."""
        await trio.lowlevel.checkpoint()
        if (OURS, port) in self.sockets:
            raise WireDown(f"UDP port {port} cannot be opened (address in use). Another program may use it")
        return UdpListener(self._open(port), host)

    def adopt(self, fileno: int) -> Any:
        """As ``socket.socket``, for the duplicate of a descriptor."""
        return self.inherit(fileno, self.world.current)

    def inherit(self, fileno: int, process: Process) -> DatagramSocket:
        """Return a socket for the duplicate of a descriptor that a process has got at its start."""
        return self.SOCKET(self._bound[os.fstat(fileno).st_ino], fileno, process)

    def _open(self, port: int) -> Any:
        process = self.world.current
        open_file(process, f"UDP port {port}")
        fd = os.memfd_create("datagrams")
        bound = self._bound[os.fstat(fd).st_ino] = _Bound(self, (OURS, port))
        return self.SOCKET(bound, fd, process)


class _RobotSocket(MemorySocket):
    def __init__(self, network: DatagramNetwork, address: Address, take: Callable[[Datagram], None]) -> None:
        super().__init__(network, address)
        self._take = take

    def arrived(self, datagram: Datagram) -> None:
        self._take(datagram)


class _Bound(MemorySocket):
    """A bound address: the datagrams that wait there, and the descriptors that lead to it."""

    def __init__(self, network: DatagramNetwork, address: Address) -> None:
        super().__init__(network, address)
        self.handles: list[DatagramSocket] = []

    @property
    def has_news(self) -> bool:
        return bool(self._waiting)

    def arrived(self, datagram: Datagram) -> None:
        if len(self._waiting) < ROOM:
            self._waiting.append(datagram)
            for handle in self.handles:
                handle.process.post(handle.rouse)

    def take(self) -> Datagram:
        if not self._waiting:
            raise BlockingIOError
        return self._waiting.popleft()


class DatagramSocket:
    """The methods of a socket that the ports use, and ``readable`` for ``trio.lowlevel``.

    It is closed when its process ends.
    """

    def __init__(self, bound: _Bound, fd: int, process: Process) -> None:
        self.process = process
        self._bound = bound
        self._fd = fd
        self._news = trio.Event()
        bound.handles.append(self)
        process.at_end.append(self._drop)

    def setblocking(self, flag: bool) -> None:
        """Do nothing: this socket never blocks."""

    def getsockname(self) -> Address:
        return self._bound.address

    def fileno(self) -> int:
        return self._fd

    def send(self, data: bytes) -> int:
        return self.sendto(data, self._network.address)

    def sendto(self, data: bytes, address: Address) -> int:
        self._check()
        process = self.process
        if not process.dead:
            datagram = Datagram(self._network.world.now_s, process.role, self._bound.address, data)
            self._network.sent(datagram)
            self._network.send(datagram, address)
        return len(data)

    def recv(self, size: int) -> bytes:
        return self.recvfrom(size)[0]

    def recvfrom(self, size: int) -> tuple[bytes, Address]:
        self._check()
        datagram = self._bound.take()
        return datagram.data[:size], datagram.sender

    async def readable(self) -> None:
        await trio.lowlevel.checkpoint()
        while not self._bound.has_news:
            self._check()
            self._news = trio.Event()
            await self._news.wait()

    def rouse(self) -> None:
        self._news.set()

    def close(self) -> None:
        if self._fd >= 0 and not self.process.dead:
            self.process.resources.close_file()
            self._drop()
            self.rouse()

    @property
    def _network(self) -> DatagramNetwork:
        return cast("DatagramNetwork", self._bound.network)

    def _drop(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
            self._bound.handles.remove(self)
            if not self._bound.handles:
                self._bound.close()

    def _check(self) -> None:
        if self._fd < 0:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))


DatagramNetwork.SOCKET = DatagramSocket
