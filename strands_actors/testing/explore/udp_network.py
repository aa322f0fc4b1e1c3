"""UDP between the processes of a tree and one robot, in memory: datagrams that are lost, late, out of
order or doubled."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import trio

from .exhaustion import open_file
from .hostile_peer import HostilePeer, Stream
from .world import Process, World

Address = tuple[str, int]

ROOM = 512
"""Datagrams that a socket keeps for a process that does not read [assumed: 1 MB]."""


class Datagram(NamedTuple):
    """``left_s``: when it was sent; ``role``: of the process, "" for the robot."""

    left_s: float
    role: str
    sender: Address
    data: bytes


class UdpNetwork:
    """Its public attributes are what is wrong with it. ``robot``: the host at its other end."""

    def __init__(self, world: World, robot: str, ports: Callable[[int, int], tuple[int, int]]) -> None:
        """``ports``: of the participant with an index in a domain, for discovery and for data."""
        self.world = world
        self.robot = robot
        self.cut: set[str] = set()  # out: to the robot; in: from it
        self.lost = 0.0  # share
        self.doubled = 0.0
        self.spoiled = 0.0  # of what is sent to the robot
        self.late_s = 0.0
        self.peer = HostilePeer(world.rng("peer"))
        self._answers: dict[Address, Stream] = {}  # of the robot, by who gets them
        self.sockets: dict[Address, UdpSocket] = {}
        self._ports = ports
        self._rng = world.rng("network")

    def open_sockets(self, domain: int, address: str, multicast: bool) -> tuple[UdpSocket, ...]:
        """As ``rtps.sockets.open_sockets``; there is no multicast."""
        if self.world.running is not None:
            open_file(self.world.running, address)
        index = 0
        while any((address, port) in self.sockets for port in self._ports(domain, index)):
            index += 1
        return tuple(UdpSocket(self, (address, port)) for port in self._ports(domain, index))

    def send(self, datagram: Datagram, to: Address) -> None:
        rng, world = self._rng, self.world
        way = "out" if to[0] == self.robot else "in"
        if way in self.cut or (self.lost and rng.random() < self.lost):
            return
        if self.spoiled and way == "out" and rng.random() < self.spoiled:
            at = rng.randrange(len(datagram.data))
            data = datagram.data
            spoiled = data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]
            datagram = datagram._replace(data=spoiled)
        pieces = [datagram.data]
        if way == "in":
            stream = self._answers.setdefault(to, self.peer.stream())
            pieces = stream.spoil(datagram.data)
        times = 2 if self.doubled and rng.random() < self.doubled else 1
        for data in pieces * times:
            late_s = self.late_s * rng.random() if self.late_s else 0.0
            arrives_s = world.now_s + 30e-6 + 90e-6 * rng.random() + late_s
            world.at(arrives_s, partial(self._arrive, datagram._replace(data=data), to))

    def _arrive(self, datagram: Datagram, to: Address) -> None:
        sock = self.sockets.get(to)
        if sock is not None:
            sock.arrived(datagram)


class UdpSocket:
    """What a participant needs of a socket. It dies with its process."""

    def __init__(self, network: UdpNetwork, address: Address) -> None:
        self.network = network
        self.address = address
        self.process: Process | None = network.world.running  # None: the robot's own
        self.newest: Datagram | None = None
        """The last that was read."""
        self.on_arrival: Callable[[], None] | None = None
        """Of the robot, which has no loop."""
        self._waiting: deque[Datagram] = deque()
        self._news: trio.Event | None = None
        network.sockets[address] = self
        if self.process is not None:
            self.process.at_end.append(self.close)

    def sendmsg(self, parts: Sequence[Any], ancillary: object, flags: int, address: Address) -> int:
        process, world = self.process, self.network.world
        data = b"".join(parts)
        if process is None or not process.dead:
            role = "" if process is None else process.role
            self.network.send(Datagram(world.now_s, role, self.address, data), address)
        return len(data)

    def recvmsg_into(self, buffers: Sequence[bytearray], room: int) -> tuple[int, list[Any], int, Address]:
        if not self._waiting:
            raise BlockingIOError
        datagram = self.newest = self._waiting.popleft()
        buffers[0][: len(datagram.data)] = datagram.data
        return len(datagram.data), [], 0, datagram.sender

    def getsockname(self) -> Address:
        return self.address

    def arrived(self, datagram: Datagram) -> None:
        if len(self._waiting) < ROOM:
            self._waiting.append(datagram)
        if self.on_arrival is not None:
            self.on_arrival()
        elif self._news is not None and self.process is not None:
            self.process.post(self.rouse)

    async def readable(self) -> None:
        """As ``trio.lowlevel.wait_readable`` of it."""
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
