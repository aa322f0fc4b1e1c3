"""Model a robot by a twin that exchanges datagrams, each of which is handled at once."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from types import ModuleType, SimpleNamespace
from typing import ClassVar

from tests.memory_udp import Address, Datagram

from .datagram_socket import DatagramNetwork
from .kinds import PEER
from .plan import Event
from .robot_model import Effect, Seam, put
from .twin_robot import TwinRobot
from .udp_network import UdpNetwork
from .world import World

TICK_S = 0.01
LATE_S = 0.02
SHARE = 0.3
"""Share of the datagrams that are lost or doubled."""


class NetworkRobot(TwinRobot):
    """A robot on a network of datagrams.

    Attributes:
        network: The network.
        stalled: True while the robot neither reads nor sends.
    """

    network: UdpNetwork
    stalled: bool

    def effect(self, event: Event) -> Effect | None:
        network = self.network
        match event.kind:
            case "pull":
                return lambda: network.cut.update(("out", "in")), network.cut.clear
            case "lose requests":
                return lambda: network.cut.add("out"), lambda: network.cut.discard("out")
            case "lose replies":
                return lambda: network.cut.add("in"), lambda: network.cut.discard("in")
            case "drop":
                return put(network, "lost", SHARE, 0.0)
            case "late":
                return put(network, "late_s", LATE_S, 0.0)
            case "twice":
                return put(network, "doubled", SHARE, 0.0)
            case "stall":
                return put(self, "stalled", True, False)
            case kind if kind in PEER:
                return put(network.peer, "kind", kind, "")
        return super().effect(event)

    def mend(self) -> None:
        super().mend()
        network = self.network
        network.cut.clear()
        network.lost = network.late_s = network.doubled = 0.0
        network.peer.kind = ""
        self.stalled = False


class DatagramRobot(NetworkRobot):
    """A robot at a UDP port.

    Attributes:
        ADDRESS: Its host and port.
        OPENERS: Modules with their own names for the functions of ``udp_port``.
        ADOPTERS: Modules that make a socket of a descriptor.
    """

    network: DatagramNetwork

    ADDRESS: ClassVar[Address]
    OPENERS: ClassVar[tuple[tuple[ModuleType, str], ...]]
    ADOPTERS: ClassVar[tuple[ModuleType, ...]] = ()

    def __init__(self, world: World, robot: str) -> None:
        super().__init__(world, robot)
        self.network = DatagramNetwork(world, self.ADDRESS, self._hear, self.sent)
        self.stalled = False
        self._unread: deque[Datagram] = deque()
        world.after(TICK_S, self._tick)

    @abstractmethod
    def take(self, datagram: Datagram) -> None:
        """Carry out a datagram of a process, and note its frame."""

    def sent(self, datagram: Datagram) -> None:
        """Note a datagram when a process sends it, even if it is lost."""

    def send(self, data: bytes, to: Address) -> None:
        self.network.send(Datagram(self.world.now_s, "", self.ADDRESS, self.spoil(data)), to)

    def seams(self) -> tuple[Seam, ...]:
        network = self.network
        return (
            *super().seams(),
            *((module, name, getattr(network, name)) for module, name in self.OPENERS),
            *((module, "socket", SimpleNamespace(socket=network.adopt)) for module in self.ADOPTERS),
        )

    def _hear(self, datagram: Datagram) -> None:
        if self.stalled:
            self._unread.append(datagram)
        else:
            self.take(datagram)

    def _tick(self) -> None:
        if not self.stalled:
            while self._unread:
                self.take(self._unread.popleft())
            self.pass_time()
            self.look()
        self.world.after(TICK_S, self._tick)
