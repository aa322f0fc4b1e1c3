"""The participant: an engine on its sockets, and the trio loop that serves them.

Writing needs no loop: the sockets are open and ``Writer.write`` is an ordinary function. Where no
task can run beside the caller, ``poll`` does one round of what ``run`` does for ever.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import AsyncIterator, Sequence
from contextlib import aclosing, asynccontextmanager

import trio

from strands_actors.kernel.clock import Clock, MonotonicClock

from . import wire_types
from .discovery import ParticipantData
from .engine import Counters, Engine, OnSample
from .peer_address import parse_peer_address
from .reader import MAX_SAMPLE, Reader
from .sockets import ANCILLARY, age_ns, is_host, open_sockets
from .wire_types import Address, Buffer
from .writer import Writer

TICK_S = 0.05
LEASE_S = 10.0
"""How long a peer believes in us without hearing of us."""
PORTS_ASKED = 10
"""Of a peer given without a port: as many participants of its host are looked for."""
DEPTH = 16
"""Samples a reliable writer keeps for those who ask again."""

SLOW_NS = 10_000_000
"""How often ``poll`` looks at more than user data."""
FRESH_NS = 1_000_000
"""Behind a datagram that came so lately there is hardly another one: looking for it costs more than
taking it."""

_USER = 1
"""Of the sockets, the one where user data arrives."""
_DATAGRAM = 65536
_ROUND = 128
"""Datagrams, and parts of them, that are taken from one socket before others get their turn."""
_ROUND_NS = 1_000_000
"""The same, in time: some datagrams cost a hundred times as much as others (SAF-025)."""


class Participant:
    """Opened by its constructor; ``run`` serves it; ``close`` ends it. Not for use by two
    threads."""

    def __init__(
        self,
        domain: int = 0,
        address: str = "127.0.0.1",
        peers: Sequence[str] = (),
        multicast: bool = True,
        lease_s: float = LEASE_S,
        clock: Clock | None = None,
        only: str = "",
    ) -> None:
        """``address``: the IPv4 address of ours to be reached at; it selects the interface.
        ``peers``: ``host`` or ``host:port`` of participants to look for by unicast. ``only``: have
        no other peers than the participants of this ``host``, or the one at ``host:port``, and hear
        nothing in their names from elsewhere: on a network of many robots, whoever finds us would
        hear what we write otherwise, and whoever claims to be the robot would be believed. Raise
        ``ValueError`` for what cannot be meant, ``WireDown`` when the sockets cannot be had."""
        if not 0 <= domain <= wire_types.MAX_DOMAIN:
            raise ValueError(f"domain is {domain}. Give 0..{wire_types.MAX_DOMAIN}")
        if not is_host(address):
            raise ValueError(f"address is {address!r}. Give an IPv4 address of this host, which peers can reach")
        asked = [where for peer in peers for where in _peer(peer, domain)]
        if multicast:
            asked.insert(0, (wire_types.MULTICAST_GROUP, wire_types.multicast_port(domain)))
        self.trouble = ""
        """Why the last datagram that could not be sent was not."""
        self._clock = clock or MonotonicClock()
        self._buffer = bytearray(_DATAGRAM)
        self._view = memoryview(self._buffer).toreadonly()
        self._changed = trio.lowlevel.ParkingLot()
        self._slow_ns = 0
        self._sockets = open_sockets(domain, address, multicast)
        self._out = self._sockets[0]
        self._empty_ns = dict.fromkeys(self._sockets, self._clock.now_ns())  # when there was nothing to read
        here = [sock.getsockname() for sock in self._sockets[:2]]
        prefix = wire_types.VENDOR + os.urandom(wire_types.PREFIX_SIZE - len(wire_types.VENDOR))
        data = ParticipantData(prefix, (here[0],), (here[1],), lease_s)
        peer = parse_peer_address(only) if only else None
        self._engine = Engine(data, asked, self._send, self._changed.unpark_all, peer)
        self._engine.tick(self._clock.now_ns())

    @property
    def address(self) -> str:
        """``host:port``, as another participant's ``peers`` takes it."""
        host, port = self._engine.data.discovery[0]
        return f"{host}:{port}"

    @property
    def guid_prefix(self) -> bytes:
        return self._engine.data.prefix

    def address_of(self, prefix: bytes) -> Address | None:
        """Return where a peer is spoken to; None: it is not known."""
        return self._engine.address_of(prefix)

    @property
    def peers(self) -> int:
        """Participants we know."""
        return self._engine.peers

    @property
    def counters(self) -> Counters:
        return self._engine.counters

    def writer(
        self,
        topic: str,
        type_name: str,
        *,
        reliable: bool = False,
        transient_local: bool = False,
        depth: int = DEPTH,
    ) -> Writer:
        """Names as they are on the wire: ``rt/lowcmd``, ``unitree_hg::msg::dds_::LowCmd_``."""
        return self._engine.writer(topic, type_name, reliable, transient_local, depth)

    def reader(
        self,
        topic: str,
        type_name: str,
        on_sample: OnSample,
        *,
        reliable: bool = False,
        transient_local: bool = False,
        max_bytes: int = MAX_SAMPLE,
    ) -> Reader:
        """``on_sample(payload, writer_guid, t_ns)`` is called from ``run`` or ``poll``. The
        payload, with its encapsulation header, is valid during the call; what it raises ends
        ``run``. A sample in fragments that would be longer than ``max_bytes`` is not begun."""
        return self._engine.reader(topic, type_name, reliable, transient_local, on_sample, max_bytes)

    async def wait_matched(self, *endpoints: Writer | Reader, n: int = 1) -> None:
        """Until each of them has ``n`` counterparts. The caller sets the deadline."""
        while any(endpoint.matched < n for endpoint in endpoints):
            await self._changed.park()

    # -- serving

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Serve until ``close``."""
        async with trio.open_nursery() as nursery:
            for sock in self._sockets:
                nursery.start_soon(self._serve, sock)
            nursery.start_soon(self._keep_time)
            task_status.started()

    def poll(self) -> None:
        """Take what has arrived, do what is due, wait for nothing. Between two looks at everything
        it takes user data alone, as far as the first that has just come: what is behind that waits
        for the next call."""
        if not self._sockets:
            return
        now_ns = self._clock.now_ns()
        if now_ns < self._slow_ns:
            self._drain(self._sockets[_USER], FRESH_NS)
            return
        self._slow_ns = now_ns + SLOW_NS
        for sock in self._sockets:
            self._drain(sock)
        if self._sockets:
            self._engine.tick(self._clock.now_ns())

    def close(self) -> None:
        """Say goodbye, so that peers need not wait for the lease to end. Harmless when called
        again."""
        if not self._sockets:
            return
        self._engine.say_goodbye()
        sockets, self._sockets = self._sockets, ()
        for sock in sockets:
            with contextlib.suppress(RuntimeError):  # no trio here: nobody waits for it either
                trio.lowlevel.notify_closing(sock)
            sock.close()

    async def _serve(self, sock: socket.socket) -> None:
        while self._sockets:
            with contextlib.suppress(trio.ClosedResourceError):
                await trio.lowlevel.wait_readable(sock)
                self._drain(sock)

    async def _keep_time(self) -> None:
        async with aclosing(self._clock.ticks(TICK_S)) as ticks:
            async for _ in ticks:
                if not self._sockets:
                    return
                self.poll()

    def _drain(self, sock: socket.socket, fresh_ns: int = 0) -> None:
        left, began_ns, now_ns = _ROUND, 0, 0
        while left > 0 and now_ns - began_ns <= _ROUND_NS:
            if not self._sockets:
                return  # closed by a callback
            try:
                size, ancillary, _, sender = sock.recvmsg_into((self._buffer,), ANCILLARY)
            except BlockingIOError:
                self._empty_ns[sock] = self._clock.now_ns()
                return
            except OSError as error:
                self.trouble = str(error)
                return
            now_ns = self._clock.now_ns()
            began_ns = began_ns or now_ns
            age = age_ns(ancillary[0][2], now_ns - self._empty_ns[sock]) if ancillary else 0
            left -= 1 + self._engine.receive(self._view[:size], sender, now_ns - age)
            if ancillary and age < fresh_ns:
                return

    def _send(self, parts: Sequence[Buffer], address: Address) -> bool:
        try:
            self._out.sendmsg(parts, (), 0, address)
        except OSError as error:
            self.trouble = f"{address[0]}:{address[1]}: {error.strerror or error}"
            return False
        return True


@asynccontextmanager
async def open_participant(
    domain: int = 0,
    address: str = "127.0.0.1",
    peers: Sequence[str] = (),
    multicast: bool = True,
    lease_s: float = LEASE_S,
    clock: Clock | None = None,
) -> AsyncIterator[Participant]:
    """A ``Participant`` that is served as long as the block lasts."""
    participant = Participant(domain, address, peers, multicast, lease_s, clock)
    try:
        async with trio.open_nursery() as nursery:
            await nursery.start(participant.run)
            yield participant
            participant.close()
            nursery.cancel_scope.cancel()
    finally:
        participant.close()


def _peer(text: str, domain: int) -> list[Address]:
    """Return where to look for ``host`` or ``host:port``."""
    host, _, port = text.partition(":")
    if not is_host(host):
        raise ValueError(f"peer is {text!r}. Give an IPv4 address: 192.0.2.10 or 192.0.2.10:7410")
    if not port:
        return [(host, wire_types.discovery_port(domain, index)) for index in range(PORTS_ASKED)]
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(f"peer is {text!r}. Give a port of 1..65535, or none")
    return [(host, int(port))]
