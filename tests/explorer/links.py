"""Links and meshes between simulated processes, with the real frames, refusals and permissions, in
simulated time."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import msgspec
import trio

from strands_actors.kernel.channels.permissions import Channel
from strands_actors.kernel.frames import decode_frame
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Node, Unreachable

from .world import Process, World

SOCKET_BYTES = 208 * 1024 + 256 * 1024
"""Capacity of a frozen peer's socket and of ``Link``'s backlog together."""

KINDS = ("tell", "ask", "reply", "watch", "down", "hosts")


class Socket:
    """One end of a socket pair. It keeps the order, loses nothing, and ends when either process ends."""

    def __init__(self, process: Process) -> None:
        self.process = process
        self.peer: Socket
        self.queue: deque[tuple[bytes, tuple[int, ...]]] = deque()
        self.bytes = 0
        self.ended = False
        self.readable: trio.Event | None = None
        process.at_end.append(self.hang_up)

    def send(self, data: bytes, descriptors: tuple[int, ...]) -> bool:
        peer = self.peer
        if self.process.dead:
            return True
        if peer.process.gone or self.ended or peer.ended:
            return False
        if not peer.process.dead and peer.bytes + len(data) <= SOCKET_BYTES:
            peer.queue.append((data, tuple(os.dup(fd) for fd in descriptors)))
            peer.bytes += len(data)
            peer.process.hears(data)
            peer.process.post(peer.rouse)
        return True

    def hang_up(self) -> None:
        """Close this end. The peer reads the frames that are queued for it, then the end."""
        self.ended = True
        for _, descriptors in self.queue:
            for fd in descriptors:
                os.close(fd)
        self.queue.clear()
        self.peer.process.post(self.peer.rouse)

    def rouse(self) -> None:
        if self.readable is not None:
            self.readable.set()

    def close(self) -> None:
        self.hang_up()


def socket_pair(one: Process, other: Process) -> tuple[Socket, Socket]:
    ends = Socket(one), Socket(other)
    ends[0].peer, ends[1].peer = ends[1], ends[0]
    return ends


class SimLink:
    """Replaces ``Link``, on a ``Socket``."""

    def __init__(
        self,
        node: Node,
        sock: Socket,
        on_closed: Callable[[], None] | None = None,
        channel: Channel | None = None,
    ) -> None:
        self.channel = channel
        self._node = node
        self._socket = sock
        self._on_closed = on_closed
        self.closed = False

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        sock = self._socket
        try:
            self._node.attach(self)
            task_status.started()
            while not self.closed:
                sock.readable = trio.Event()
                if not sock.queue and not sock.peer.ended:
                    await sock.readable.wait()
                else:
                    await trio.lowlevel.checkpoint()
                with self._node.dispatch:
                    while sock.queue and not self.closed:
                        data, descriptors = sock.queue.popleft()
                        sock.bytes -= len(data)
                        self._node.receive_frame(data, self, descriptors)
                if sock.peer.ended and not sock.queue:
                    break
        finally:
            self.close()

    def close(self) -> None:
        if self.closed:
            return
        self.closed = True
        self._socket.close()
        self._socket.rouse()
        self._node.detach(self)
        if self._on_closed is not None:
            self._on_closed()

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        if self.closed:
            return False
        if descriptors:  # Their numbers differ from run to run, so the frame is not recorded.
            self._socket.process.world.note(self._socket.process.role, "hands over", f"{len(descriptors)}")
        else:
            _note(self._socket.process, data)
        return self._socket.send(data, descriptors)

    def send_at_once(self, data: bytes) -> bool:
        return False

    def announce(self, address: str, hosted: bool) -> None:
        self.send("", self._node.hosts_frame(address, hosted))


class Net:
    """Zenoh between the processes of one host.

    Messages of one sender and lane keep their order. An urgent one may overtake. All messages to and from
    a process in ``cut`` are lost.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self.sessions: list[SimMesh] = []
        self.cut: set[str] = set()  # roles
        self.slow_s = 0.0
        self._rng = world.rng("mesh")
        self._last_s: dict[tuple[int, int, bool], float] = {}

    def route(self, network: str, to: str) -> SimMesh | None:
        for session in self.sessions:
            if session.network == network and to in session.addresses():
                return session
        return None

    def join(self, session: SimMesh) -> None:
        self.sessions.append(session)
        session.process.at_end.append(lambda: self.leave(session))

    def leave(self, session: SimMesh) -> None:
        """Remove a session. The other sessions of its network notice it, unless they are cut off."""
        if session not in self.sessions:
            return
        self.sessions.remove(session)
        for other in self.sessions:
            if other.network == session.network and other.process.role not in self.cut:
                other.process.post(partial(other.lose, session.addresses()))

    def carry(self, source: SimMesh, target: SimMesh, data: bytes, urgent: bool) -> None:
        if source.process.role in self.cut or target.process.role in self.cut:
            self.world.note("mesh", "loses", data)
            return
        rng = self._rng
        delay_s = 100e-6 + 400e-6 * rng.random()
        if rng.random() < 0.02:
            delay_s += 0.02 * rng.random()
        if self.slow_s:
            delay_s += self.slow_s * rng.random()
        way = (id(source), id(target), urgent)
        due_s = max(self._last_s.get(way, 0.0), self.world.now_s + delay_s)
        self._last_s[way] = due_s
        self.world.at(due_s, lambda: target.arrived(data, urgent))


class SimMesh:
    """Replaces ``ZenohMesh``. A policy's endpoint is separate from the user's mesh."""

    net: Net

    def __init__(self, process: Process, network: str) -> None:
        self._channel: Channel | None = None
        self.process = process
        self.network = network
        self.node: Node
        self._address = ""
        self._urgent: deque[bytes] = deque()
        self._inbox: deque[bytes] = deque()
        self._arrived: trio.Event | None = None

    @classmethod
    async def open(
        cls,
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        settings: Mapping[str, Any] | None = None,
        secret: str = "",
    ) -> SimMesh:
        net = cls.net
        process = net.world.current
        await trio.sleep(0.002 + 0.01 * net.world.rng("mesh").random())
        apart = any(endpoint.startswith("policy") for endpoint in (*listen, *connect))
        return cls(process, "policy" if apart else "user")

    @property
    def channel(self) -> Channel | None:
        return self._channel

    @channel.setter
    def channel(self, channel: Channel | None) -> None:
        """Set the channel. On the user's network it accepts any sender: operators normally come by the
        gateway, but share the caller's mesh here."""
        if channel is not None and self.network == "user":
            channel = channel._replace(hosts=None)
        self._channel = channel

    def attach(self, node: Node) -> None:
        self.node = node
        node.mesh = self
        self.net.join(self)

    def let_in(self, node: Node, address: str) -> None:
        self.node = node
        self._address = address
        self.net.join(self)

    async def let_guests_in(
        self, listen: Sequence[str], channel: Channel, addresses: Sequence[str], show: str
    ) -> None:
        """No-op: a simulation has no guests."""

    def addresses(self) -> list[str]:
        """Return the addresses that this session reaches."""
        return [self._address] if self._address else [self.node.address, *self.node.cells]

    def lose(self, addresses: Sequence[str]) -> None:
        if self.node.mesh is self:
            for address in addresses:
                self.node.lost(address)

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        task_status.started()
        while True:
            self._arrived = trio.Event()
            if not self._urgent and not self._inbox:
                await self._arrived.wait()
            else:
                await trio.lowlevel.checkpoint()
            with self.node.dispatch:
                while self._urgent or self._inbox:
                    queue = self._urgent or self._inbox
                    self.node.receive_frame(queue.popleft(), self)

    def arrived(self, data: bytes, urgent: bool) -> None:
        (self._urgent if urgent else self._inbox).append(data)
        self.process.hears(data)
        self.process.post(self._rouse)

    def _rouse(self) -> None:
        if self._arrived is not None:
            self._arrived.set()

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        if self.process.dead:
            return True
        target = self.net.route(self.network, to)
        if target is None:
            return False
        _note(self.process, data)
        self.net.carry(self, target, data, urgent)
        return True

    def send_at_once(self, data: bytes) -> bool:
        return False

    def ask(
        self,
        to: str,
        sender: str,
        message: Message,
        decode: Callable[[msgspec.Raw], Message | None],
        deadline_s: float,
    ) -> Message | None:
        raise Unreachable("simulated processes have no threads")

    def forget(self, to: str, why: str) -> None:
        """No-op: no thread sends requests."""

    def announce(self, address: str, hosted: bool) -> None:
        """No-op: each delivery looks the address up."""

    def close(self) -> None:
        self.net.leave(self)


def _note(process: Process, data: bytes) -> None:
    if not process.dead:
        world = process.world
        world.note(process.role, "sends", data)
        world.conversation.hear(world.now_s, process.role, process.pid, data)


def told(data: bytes) -> str:
    """Return a frame as text for people."""
    head = decode_frame(data)
    if KINDS[head.kind] == "hosts":
        return f"hosts {head.sender}"
    body = msgspec.msgpack.decode(head.body)
    return f"{KINDS[head.kind]} {head.to.rpartition('/actor/')[2]} {body}"
