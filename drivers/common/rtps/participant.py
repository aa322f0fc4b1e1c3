"""An RTPS participant: its logic, its sockets, and the trio loop that serves them.

Writing needs no loop, because the sockets are open and ``Writer.write`` is an ordinary function. A program that
cannot run a task for ``run`` calls ``poll`` regularly instead.
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
"""How long a peer keeps us without receiving an announcement."""
PORTS_TRIED = 10
"""Ports tried on the host of a peer that is given without a port."""
DEPTH = 16
"""Samples that a reliable writer keeps to send them again."""

SLOW_NS = 10_000_000
"""Period in which ``poll`` serves all sockets, and not only user data."""
FRESH_NS = 1_000_000
"""A datagram younger than this is most likely the last in its queue. Looking for another one costs
more than receiving it."""

_USER = 1
"""Index of the socket for user data."""
_DATAGRAM = 65536
_ROUND = 128
"""Datagrams and their parts that are received from one socket before the next socket is served."""
_ROUND_NS = 1_000_000
"""The same bound as a time, because some datagrams cost a hundred times as much as others (SAF-025)."""


class Participant:
    """An RTPS participant with open sockets. ``run`` serves it, ``close`` ends it. Use it in one thread only."""

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
        """Open the sockets and send the first announcement.

        Args:
            address: Our IPv4 address that peers can reach. It selects the network interface.
            peers: ``host`` or ``host:port`` of participants to look for by unicast.
            only: Accept only participants of this ``host``, or the one at ``host:port``, and drop datagrams with
                their names from other addresses. Without it, any participant on the network could read our samples,
                and any participant could pretend to be the robot.

        Raises:
            ValueError: An argument is not valid.
            WireDown: The sockets cannot be opened.
        """
        if not 0 <= domain <= wire_types.MAX_DOMAIN:
            raise ValueError(f"domain is {domain}. Give 0..{wire_types.MAX_DOMAIN}")
        if not is_host(address):
            raise ValueError(f"address is {address!r}. Give an IPv4 address of this host, which peers can reach")
        announce_to = [target for peer in peers for target in _peer(peer, domain)]
        if multicast:
            announce_to.insert(0, (wire_types.MULTICAST_GROUP, wire_types.multicast_port(domain)))
        self.trouble = ""
        """The last error of a socket."""
        self._clock = clock or MonotonicClock()
        self._buffer = bytearray(_DATAGRAM)
        self._view = memoryview(self._buffer).toreadonly()
        self._changed = trio.lowlevel.ParkingLot()
        self._slow_ns = 0
        self._sockets = open_sockets(domain, address, multicast)
        self._out = self._sockets[0]
        # Time at which a read of each socket last found no datagram.
        self._empty_ns = dict.fromkeys(self._sockets, self._clock.now_ns())
        own_addresses = [sock.getsockname() for sock in self._sockets[:2]]
        prefix = wire_types.VENDOR + os.urandom(wire_types.PREFIX_SIZE - len(wire_types.VENDOR))
        data = ParticipantData(prefix, (own_addresses[0],), (own_addresses[1],), lease_s)
        peer = parse_peer_address(only) if only else None
        self._engine = Engine(data, announce_to, self._send, self._changed.unpark_all, peer)
        self._engine.tick(self._clock.now_ns())

    @property
    def address(self) -> str:
        """Our ``host:port``. Another participant can give it in its ``peers``."""
        host, port = self._engine.data.discovery[0]
        return f"{host}:{port}"

    @property
    def guid_prefix(self) -> bytes:
        return self._engine.data.prefix

    def address_of(self, prefix: bytes) -> Address | None:
        """Return the address to which data for a peer is sent; None if the peer is unknown."""
        return self._engine.address_of(prefix)

    @property
    def peers(self) -> int:
        """Number of other participants that are known."""
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
        """Create a writer. Topic and type must have their names in DDS: ``rt/lowcmd``,
        ``unitree_hg::msg::dds_::LowCmd_``."""
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
        """Create a reader.

        Args:
            on_sample: Called by ``run`` or ``poll`` with ``(payload, writer_guid, t_ns)``. The payload has its
                encapsulation header, and is valid during the call. An exception ends ``run``.
            max_bytes: Longest accepted sample. A longer sample in fragments is dropped before memory is allocated.
        """
        return self._engine.reader(topic, type_name, reliable, transient_local, on_sample, max_bytes)

    async def wait_matched(self, *endpoints: Writer | Reader, n: int = 1) -> None:
        """Wait until each of these writers and readers is matched with ``n`` remote endpoints. The caller must set
        a timeout."""
        while any(endpoint.matched < n for endpoint in endpoints):
            await self._changed.park()

    # -- serving

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Serve the participant until ``close`` is called."""
        async with trio.open_nursery() as nursery:
            for sock in self._sockets:
                nursery.start_soon(self._serve, sock)
            nursery.start_soon(self._keep_time)
            task_status.started()

    def poll(self) -> None:
        """Process waiting datagrams and send messages that are due, without blocking.

        Once per ``SLOW_NS`` a call serves all sockets. The other calls receive user data only, and return after the
        first datagram that is younger than ``FRESH_NS``. The following datagrams wait for the next call.
        """
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
        """Inform the peers of our end, so that they need not wait until our lease (the time for which we may be
        silent) ends, and close the sockets. It may be called again."""
        if not self._sockets:
            return
        self._engine.say_goodbye()
        sockets, self._sockets = self._sockets, ()
        for sock in sockets:
            # This fails without a trio loop, in which case no task waits for the socket.
            with contextlib.suppress(RuntimeError):
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
        remaining, began_ns, now_ns = _ROUND, 0, 0
        while remaining > 0 and now_ns - began_ns <= _ROUND_NS:
            if not self._sockets:
                # A callback has closed the participant, so its sockets cannot be read any more.
                return
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
            remaining -= 1 + self._engine.receive(self._view[:size], sender, now_ns - age)
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
    """Open a ``Participant``, and serve it until the ``async with`` block ends."""
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
    """Return the addresses at which a participant on ``host`` or ``host:port`` may listen."""
    host, _, port = text.partition(":")
    if not is_host(host):
        raise ValueError(f"peer is {text!r}. Give an IPv4 address: 192.0.2.10 or 192.0.2.10:7410")
    if not port:
        return [(host, wire_types.discovery_port(domain, index)) for index in range(PORTS_TRIED)]
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(f"peer is {text!r}. Give a port of 1..65535, or no port")
    return [(host, int(port))]
