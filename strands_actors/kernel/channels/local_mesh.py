"""A mesh in memory, for tests and for virtual time (trio's MockClock).

It carries the same frames and refusals as a real mesh, without I/O. A node can be disconnected and connected
again, as on a network.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import msgspec

from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Node, Unreachable

from .permissions import Channel


class LocalNetwork:
    """Connects the ``LocalMesh`` objects of several nodes."""

    def __init__(self) -> None:
        self._meshes: dict[str, LocalMesh] = {}
        self._cut: set[str] = set()

    def join(self) -> LocalMesh:
        """Return a mesh for one node; pass it to ``Node`` and then call ``attach(node)``."""
        return LocalMesh(self)

    def cut(self, node: Node) -> None:
        """Disconnect a node. Frames from it and to it are lost, and the other nodes learn that it is gone."""
        self._cut.add(node.address)
        for mesh in list(self._meshes.values()):
            if mesh.node is not node:
                mesh.lose_peer(node)
                self._meshes[node.address].lose_peer(mesh.node)

    def heal(self, node: Node) -> None:
        self._cut.discard(node.address)

    def add(self, mesh: LocalMesh) -> None:
        self._meshes[mesh.node.address] = mesh

    def remove(self, mesh: LocalMesh) -> None:
        self._meshes.pop(mesh.node.address, None)
        for peer in list(self._meshes.values()):
            peer.lose_peer(mesh.node)

    def deliver(self, source: Node, to: str, data: bytes, descriptors: tuple[int, ...] = ()) -> bool:
        if source.address in self._cut:
            return False
        for address, mesh in self._meshes.items():
            if address in self._cut:
                continue
            if to == address or to in mesh.node.cells:
                mesh.node.receive_frame(data, mesh, tuple(os.dup(fd) for fd in descriptors))
                return True
        return False


class LocalMesh:
    def __init__(self, network: LocalNetwork) -> None:
        self.channel: Channel | None = None
        self._network = network
        self.node: Node

    def attach(self, node: Node) -> None:
        self.node = node
        node.mesh = self
        self._network.add(self)

    def close(self) -> None:
        self._network.remove(self)

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        return self._network.deliver(self.node, to, data, descriptors)

    def ask(
        self,
        to: str,
        sender: str,
        message: Message,
        decode: Callable[[msgspec.Raw], Message | None],
        deadline_s: float,
    ) -> Message | None:
        raise Unreachable("in memory there are no threads")

    def forget(self, to: str, reason: str) -> None:
        """No-op, since no thread sends requests over this mesh."""

    def send_at_once(self, data: bytes) -> bool:
        return False

    def announce(self, address: str, hosted: bool) -> None:
        """No-op, since each delivery looks up the address."""

    def lose_peer(self, peer: Node) -> None:
        for address in (peer.address, *peer.cells):
            self.node.lost(address)
