"""A robot behind TCP ports: many clients, each with a conversation of its own.

Every twin has a host address of its own, 127.x.y.z, since several wires have fixed ports. Pulling
the cable ends every connection and refuses new ones; a robot that is frozen takes them and says
nothing.
"""

from __future__ import annotations

import contextlib
import os
import random
import socket
import struct
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Mapping, Sequence

import trio

from strands_actors.drivers.common.physics.body import Body, body_of

from .faults import parse_fault
from .lateness import Lateness
from .line import CHUNK
from .server import Controls, Conversation, Frost, TwinSession
from .wirelog import WireLog

BACKLOG = 64
ATTEMPTS = 64
OFFERED_BYTES = 16 * 1024


class ClientGone(Exception):
    """The client has closed its connection, or the cable was pulled."""


class Connection:
    """One client: a ``Channel``, and for handlers that talk unasked ``heard`` and ``say``."""

    def __init__(self, sock: socket.socket, log: WireLog, frost: Frost) -> None:
        self._sock = sock
        self.late_s = 0.0
        """What it sends is taken up so much later, in its order."""
        self.log = log
        self.frost = frost
        self._owed = b""  # what the client has not taken yet of an offer
        self._offers = False

    @property
    def peer_host(self) -> str:
        """Return the client's address; empty once it is gone."""
        try:
            return str(self._sock.getpeername()[0])
        except OSError:
            return ""

    def bits_per_s(self) -> int | None:
        return None

    def quiet_for(self, seconds: float) -> bool:
        return False  # others are served by the same loop: nobody may block it

    async def receive(self) -> tuple[int, bytes]:
        """Return the next bytes and when they were read. Raise ``ClientGone``."""
        while True:
            try:
                await trio.lowlevel.wait_readable(self._sock)
                await self.frost.thawed()
                data = self._sock.recv(CHUNK)
            except BlockingIOError:
                continue
            except (OSError, ValueError, trio.ClosedResourceError):
                data = b""
            if not data:
                raise ClientGone
            if self.late_s:
                await trio.sleep(self.late_s)
            return time.monotonic_ns(), data

    def send(self, data: bytes) -> None:
        """Never waits. A client that does not take a frame whole loses the connection: the rest
        would not be understood."""
        try:
            sent = self._sock.send(data)
        except BlockingIOError:
            sent = 0
        except OSError:
            return  # its end is read, too
        if sent != len(data):
            self.abort()

    @property
    def takes(self) -> bool:
        """Return whether the last offer was taken whole; what is left of it is sent first."""
        if self._owed:
            self._owed = self._owed[self._sent(self._owed) :]
        return not self._owed

    def offer(self, data: bytes) -> None:
        """Send what a client may also not read, as those do that only came to say something: then
        frames are left out, whole ones."""
        if not self._offers:  # what nobody reads is not kept by the megabyte, nor the work done for it
            self._offers = True
            with contextlib.suppress(OSError):  # its end is read, too
                self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, OFFERED_BYTES)
        if self.takes:
            self._owed = data[self._sent(data) :]

    def _sent(self, data: bytes) -> int:
        try:
            return self._sock.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            return len(data)  # its end is read, too

    def heard(self, t_ns: int, kind: str, data: bytes) -> None:
        """Log a frame of the client's."""
        self.log.write(t_ns, "host", [(kind, data)])

    def say(self, kind: str, data: bytes) -> None:
        """Log and send a frame of the robot's."""
        self.log.write(time.monotonic_ns(), "robot", [(kind, data)])
        self.send(data)

    def be_late(self, lateness: Lateness) -> None:
        """Take up what this client sends later, if it is the one."""
        self.late_s = lateness.of(self._sock)

    def hang_up(self) -> None:
        """End it in order: what was said arrives."""
        if self._sock.fileno() >= 0:
            trio.lowlevel.notify_closing(self._sock)
            self._sock.close()

    def abort(self) -> None:
        """End it with a reset. Harmless when called again."""
        if self._sock.fileno() < 0:
            return
        with contextlib.suppress(OSError):
            self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        trio.lowlevel.notify_closing(self._sock)
        self._sock.close()


Handler = Callable[[Connection], Awaitable[None]]
"""Serves one client until ``ClientGone``, which it lets pass."""


def answering(new_session: Callable[[], TwinSession]) -> Handler:
    """Return the handler of a wire on which the robot speaks only when asked."""

    async def handle(connection: Connection) -> None:
        await Conversation(new_session(), connection, connection.log, connection.frost).serve()

    return handle


class StreamServer(ABC):
    """Serves one robot on its listeners, one handler each. Its methods are what may happen to the
    robot while it runs."""

    def __init__(self, robot: Controls, handlers: Sequence[Handler], log: WireLog) -> None:
        self._robot = robot
        self._handlers = list(handlers)
        self._log = log
        self._frost = Frost()
        self._connections: set[Connection] = set()
        self._lateness = Lateness()
        self._plugged = trio.Event()
        self._listeners: list[socket.socket] = []

    @property
    @abstractmethod
    def address(self) -> str:
        """Return where clients connect."""

    @abstractmethod
    def listen(self) -> list[socket.socket]:
        """Return a listener for each handler, at the address. Raise ``OSError``."""

    def forget(self) -> None:  # noqa: B027  # what a name leaves behind: of TCP nothing
        """Remove what is left of the address when the cable is pulled."""

    @property
    def body(self) -> Body:
        """Raise ``ValueError`` for a robot that shows none."""
        return body_of(self._robot)

    def set_fault(self, text: str) -> None:
        """``WORD`` or ``WORD:unit``. Raise ``ValueError`` for another word."""
        self._robot.set_fault(*parse_fault(text))

    def power_cycle(self) -> None:
        self._robot.power_cycle()

    def plug(self) -> None:
        if not self._listeners:
            self._listeners = self.listen()
            self._plugged.set()

    def unplug(self) -> None:
        """Pull the cable. The robot itself does not notice."""
        if self._plugged.is_set():  # else it is out already, and somebody waits for it to be put back
            self._plugged = trio.Event()
        for listener in self._listeners:
            trio.lowlevel.notify_closing(listener)
            listener.close()
        self._listeners = []
        self.forget()
        for connection in list(self._connections):
            connection.abort()

    def freeze(self, seconds: float) -> None:
        """The robot neither reads nor answers for so long; then it takes up what waited."""
        self._frost.freeze(seconds)

    def be_late(self, lateness: Lateness) -> None:
        """Take up later what one process sends: on its connections of now, and on new ones."""
        self._lateness = lateness
        for connection in self._connections:
            connection.be_late(lateness)

    async def serve(self) -> None:
        """Until cancelled."""
        async with trio.open_nursery() as nursery:
            for at in range(len(self._handlers)):
                nursery.start_soon(self._accept, at, nursery)

    def close(self) -> None:
        self.unplug()

    async def _accept(self, at: int, nursery: trio.Nursery) -> None:
        while True:
            await self._plugged.wait()
            if not self._listeners:  # pulled again before we got to run
                continue
            listener = self._listeners[at]
            with contextlib.suppress(BlockingIOError, ConnectionError, trio.ClosedResourceError):
                await trio.lowlevel.wait_readable(listener)
                await self._frost.thawed()
                if listener.fileno() >= 0:
                    sock, _ = listener.accept()
                    nursery.start_soon(self._attend, sock, self._handlers[at])

    async def _attend(self, sock: socket.socket, handler: Handler) -> None:
        sock.setblocking(False)
        if sock.family != socket.AF_UNIX:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection = Connection(sock, self._log, self._frost)
        connection.be_late(self._lateness)
        self._connections.add(connection)
        try:
            await handler(connection)
        except* ClientGone:
            pass
        finally:
            self._connections.discard(connection)
            connection.abort()


class TcpServer(StreamServer):
    def __init__(
        self, robot: Controls, handlers: Mapping[int, Handler], log: WireLog, host: str | None = None
    ) -> None:
        """``handlers`` by port number, 0 for any free one; the first port is the address. ``host``:
        default an address of this twin's own. Raise ``OSError`` when the ports cannot be had."""
        super().__init__(robot, list(handlers.values()), log)
        self._listeners = _listen(host, list(handlers))
        self._names: list[tuple[str, int]] = [listener.getsockname() for listener in self._listeners]
        self.unplug()

    @property
    def address(self) -> str:
        host, port = self._names[0]
        return f"{host}:{port}"

    @property
    def host(self) -> str:
        return self._names[0][0]

    def listen(self) -> list[socket.socket]:
        return [_listener(host, port) for host, port in self._names]


def _listen(host: str | None, ports: list[int]) -> list[socket.socket]:
    """All ports on one host. An address of our own may be somebody's already: then another is
    tried."""
    for attempt in range(ATTEMPTS):
        chosen = host or own_host()
        listeners: list[socket.socket] = []
        try:
            for port in ports:
                listeners.append(_listener(chosen, port))
            return listeners
        except OSError:
            for listener in listeners:
                listener.close()
            if host or attempt == ATTEMPTS - 1:
                raise
    raise AssertionError("not reached")


def own_host() -> str:
    """Return an address for one twin alone. Any address 127.x.y.z is this machine's on Linux;
    elsewhere there is one."""
    if not sys.platform.startswith("linux"):
        return "127.0.0.1"
    chance = random.Random(os.getpid() ^ time.monotonic_ns())
    return f"127.{chance.randint(1, 254)}.{chance.randint(0, 254)}.{chance.randint(1, 254)}"


def _listener(host: str, port: int) -> socket.socket:
    listener = socket.socket()
    try:
        listener.setblocking(False)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(BACKLOG)
    except BaseException:
        listener.close()
        raise
    return listener
