"""UDP between the processes of a tree and one robot, in memory. Datagrams can be lost, late, out of order
or doubled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from tests.memory_udp import Address, Datagram, MemoryNetwork, MemorySocket

from .exhaustion import open_file
from .hostile_peer import HostilePeer, Stream
from .world import Process, World


class UdpNetwork(MemoryNetwork):
    """The network. Its public attributes are its present faults. ``robot`` is the robot's host."""

    def __init__(self, world: World, robot: str, ports: Callable[[int, int], tuple[int, int]]) -> None:
        super().__init__(ports)
        self.world = world
        self.robot = robot
        self.cut: set[str] = set()  # out: to the robot; in: from it
        self.lost = 0.0  # share
        self.doubled = 0.0
        self.spoiled = 0.0  # share of the datagrams to the robot
        self.late_s = 0.0
        self.peer = HostilePeer(world.rng("peer"))
        self._answers: dict[Address, Stream] = {}  # from the robot, by receiver
        self._rng = world.rng("network")

    def open_sockets(self, domain: int, host: str, multicast: bool) -> tuple[MemorySocket, ...]:
        if self.world.running is not None:
            open_file(self.world.running, host)
        return super().open_sockets(domain, host, multicast)

    def make_socket(self, address: Address) -> UdpSocket:
        return UdpSocket(self, address)

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
            world.at(arrives_s, partial(self.arrive, datagram._replace(data=data), to))


class UdpSocket(MemorySocket):
    """A socket that is closed when its process ends."""

    def __init__(self, network: UdpNetwork, address: Address) -> None:
        super().__init__(network, address)
        self.process: Process | None = network.world.running  # None for the robot's sockets
        if self.process is not None:
            self.process.at_end.append(self.close)

    def sendmsg(self, parts: Sequence[Any], ancillary: object, flags: int, address: Address) -> int:
        process, world = self.process, self.network.world
        data = b"".join(parts)
        if process is None or not process.dead:
            role = "" if process is None else process.role
            self.network.send(Datagram(world.now_s, role, self.address, data), address)
        return len(data)

    def tell(self) -> None:
        if self.process is not None:
            self.process.post(self.rouse)
