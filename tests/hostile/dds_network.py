"""A robot on a DDS network in memory: the twin's own server, and host participants with a hostile peer.

The host participants receive the robot's datagrams as the hostile peer has changed them. A network has no
connections that could be reset. Instead a robot falls silent: after ``reset_after`` datagrams a participant
receives nothing more from it.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import trio

from strands_actors.drivers.common.rtps import messages, participant, wire_types
from strands_actors.drivers.common.rtps.wire_types import Address
from strands_actors.drivers.common.twin.dds import DdsServer
from strands_actors.kernel.clock import VirtualClock
from tests.memory_udp import Datagram, MemoryNetwork, MemorySocket, put_into

from .peer import HostilePeer, HostileStream

ROBOT, HOST = "127.0.0.9", "127.0.0.1"
PREFIX = wire_types.VENDOR + bytes(9) + b"\1"
"""The GUID prefix of the robot's participant, which is opened first."""


class _Waiting:
    """The datagrams of one socket, in the order of arrival."""

    def __init__(self, sock: HostSocket) -> None:
        self._sock = sock

    async def read(self) -> bytes:
        while (data := self.read_waiting()) is None:
            await self._sock.arrival()
        return data

    def read_waiting(self) -> bytes | None:
        return self._sock.next_datagram()

    def close(self) -> None:
        """Do nothing: the participant closes the socket."""


class _Datagrams(HostileStream):
    """The datagrams that one socket receives. It does not report that a peer is gone."""

    def size_of(self, data: bytes) -> int:
        return 1

    def _check(self) -> None:
        """Do nothing: the socket stays open."""


class HostSocket(MemorySocket):
    """A socket of one of our participants."""

    def __init__(self, network: Network, address: Address) -> None:
        super().__init__(network, address)
        self._peer = network.peer
        self._stream = _Datagrams(network.peer, _Waiting(self))
        self._first: bytes | None = None  # the datagram that ended the last wait
        self._is_closed = False

    def sendmsg(self, parts: Sequence[Any], ancillary: object, flags: int, address: Address) -> int:
        self._peer.writes += 1
        data = b"".join(parts)
        return super().sendmsg((self._peer.garble(data) if self._peer.deaf else data,), ancillary, flags, address)

    def recvmsg_into(self, buffers: Sequence[bytearray], room: int) -> tuple[int, list[Any], int, Address]:
        data, self._first = self._first, None
        if data is None:
            data = self._stream.read_waiting()
        if data is None:
            raise BlockingIOError
        return put_into(buffers[0], data), [], 0, self.network.robot

    async def readable(self) -> None:
        await trio.lowlevel.checkpoint()
        if self._first is None:
            self._first = await self._stream.read()

    async def arrival(self) -> None:
        if self._is_closed:
            raise trio.ClosedResourceError
        await super().readable()

    def next_datagram(self) -> bytes | None:
        return self._waiting.popleft().data if self._waiting else None

    def close(self) -> None:
        self._is_closed = True
        super().close()
        self._stream.wake()
        self.rouse()


class Network(MemoryNetwork):
    """The network of one robot."""

    def __init__(self, peer: HostilePeer) -> None:
        super().__init__(lambda *which: (wire_types.discovery_port(*which), wire_types.user_port(*which)))
        self.peer = peer
        peer.chunk = 0
        self.robot: Address = (ROBOT, wire_types.discovery_port(0, 0))
        self._participants = 0

    def make_socket(self, address: Address) -> MemorySocket:
        return MemorySocket(self, address) if address[0] == ROBOT else HostSocket(self, address)

    def send(self, datagram: Datagram, to: Address) -> None:
        self.arrive(datagram, to)

    def _prefix(self, size: int) -> bytes:
        self._participants += 1
        return self._participants.to_bytes(size, "big")

    @contextlib.contextmanager
    def in_place(self, *links: ModuleType) -> Iterator[None]:
        """Give every participant its sockets on this network.

        Args:
            links: Modules that look up our own address.
        """
        readable, closing = trio.lowlevel.wait_readable, trio.lowlevel.notify_closing

        async def wait_readable(sock: Any) -> None:
            await (sock.readable() if isinstance(sock, MemorySocket) else readable(sock))

        def notify_closing(sock: Any) -> None:
            if not isinstance(sock, MemorySocket):
                closing(sock)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(participant, "open_sockets", self.open_sockets)
            patch.setattr(participant, "os", SimpleNamespace(urandom=self._prefix))
            patch.setattr(trio.lowlevel, "wait_readable", wait_readable)
            patch.setattr(trio.lowlevel, "notify_closing", notify_closing)
            for link in links:
                patch.setattr(link, "own_address", lambda host: HOST)
            yield

    @contextlib.asynccontextmanager
    async def serving(self, server: DdsServer, *links: ModuleType) -> AsyncIterator[None]:
        """Run the twin's server on this network."""
        server.clock = VirtualClock()  # type: ignore[assignment]
        with self.in_place(*links):
            server.plug()
            assert server.participant is not None and server.participant.guid_prefix == PREFIX
            for sock in self.sockets.values():
                sock.on_arrival = server.participant.poll  # so that the log has the time of each arrival
            async with trio.open_nursery() as nursery:
                nursery.start_soon(server.serve)
                yield
                nursery.cancel_scope.cancel()
            server.close()


# -- contents of a datagram


def said(*parts: bytes) -> bytes:
    """Return a datagram from the robot."""
    return messages.header(PREFIX) + b"".join(parts)


def in_samples(change: Callable[[bytearray, int], None], writer: bytes = b"") -> Callable[[bytes], bytes]:
    """Return a change of all samples in a datagram, or of the samples of one writer.

    Args:
        change: Called as ``change(datagram, at)``, where ``at`` is the start of the submessage's body.
    """

    def changed(datagram: bytes) -> bytes:
        data, at = bytearray(datagram), messages.HEADER_SIZE
        while at + 4 <= len(data):
            kind, size = data[at], int.from_bytes(data[at + 2 : at + 4], "little")
            if kind == DATA and (not writer or data[at + 12 : at + 16] == writer):
                change(data, at + 4)
            at += 4 + size
        return bytes(data)

    return changed


DATA = 0x15
WRITER_AT, SEQUENCE_AT, PAYLOAD_AT = 8, 16, 24
"""Offsets in the body of a sample. The payload begins with 4 bytes that name its encoding."""


def replaced(at: int, new: bytes) -> Callable[[bytearray, int], None]:
    def change(data: bytearray, body: int) -> None:
        data[body + at : body + at + len(new)] = new

    return change
