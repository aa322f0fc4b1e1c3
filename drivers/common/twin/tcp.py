"""A robot behind TCP ports: many clients, each with a separate conversation.

Every twin has a separate host address, 127.x.y.z, since several wires have fixed ports. Pulling the
cable ends every connection and refuses new ones. A frozen robot accepts connections and does not
answer.
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
    """One client: a ``Channel``, with ``heard`` and ``say`` for handlers that send without a request."""

    def __init__(self, sock: socket.socket, log: WireLog, frost: Frost) -> None:
        self._sock = sock
        self.late_s = 0.0
        """Delay of the client's requests in seconds. Their order stays the same."""
        self.log = log
        self.frost = frost
        self._owed = b""  # the rest of an offer that the client has not taken yet
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
        return False  # Blocking would hold up the other clients of this loop.

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
        """Send without waiting. A client that cannot take the whole frame is disconnected, because it could
        not decode a part."""
        try:
            sent = self._sock.send(data)
        except BlockingIOError:
            sent = 0
        except OSError:
            return  # ``receive`` notices the end of the connection.
        if sent != len(data):
            self.abort()

    @property
    def takes(self) -> bool:
        """Return whether the client has taken the whole last offer. Send the rest of it first."""
        if self._owed:
            self._owed = self._owed[self._sent(self._owed) :]
        return not self._owed

    def offer(self, data: bytes) -> None:
        """Send a frame that the client need not read, for example a client that only sends. While it does
        not read, whole frames are skipped."""
        if not self._offers:  # A small buffer: do not queue megabytes for a client that does not read.
            self._offers = True
            with contextlib.suppress(OSError):  # ``receive`` notices the end of the connection.
                self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, OFFERED_BYTES)
        if self.takes:
            self._owed = data[self._sent(data) :]

    def _sent(self, data: bytes) -> int:
        try:
            return self._sock.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            return len(data)  # ``receive`` notices the end of the connection.

    def heard(self, t_ns: int, kind: str, data: bytes) -> None:
        """Log a frame of the client."""
        self.log.write(t_ns, "host", [(kind, data)])

    def say(self, kind: str, data: bytes) -> None:
        """Log and send a frame of the robot."""
        self.log.write(time.monotonic_ns(), "robot", [(kind, data)])
        self.send(data)

    def be_late(self, lateness: Lateness) -> None:
        """Delay the requests of this client, if ``lateness`` is about its process."""
        self.late_s = lateness.of(self._sock)

    def hang_up(self) -> None:
        """Close the connection in order, so that all sent bytes arrive."""
        if self._sock.fileno() >= 0:
            trio.lowlevel.notify_closing(self._sock)
            self._sock.close()

    def abort(self) -> None:
        """Close the connection with a reset. No effect when it is closed."""
        if self._sock.fileno() < 0:
            return
        with contextlib.suppress(OSError):
            self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        trio.lowlevel.notify_closing(self._sock)
        self._sock.close()


Handler = Callable[[Connection], Awaitable[None]]
"""Serves one client until ``ClientGone``, which it does not catch."""


def answering(new_session: Callable[[], TwinSession]) -> Handler:
    """Return the handler of a wire on which the robot sends only replies."""

    async def handle(connection: Connection) -> None:
        await Conversation(new_session(), connection, connection.log, connection.frost).serve()

    return handle


class StreamServer(ABC):
    """Serve one robot on its listeners, with one handler each. The public methods cause events while the
    robot runs."""

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

    def forget(self) -> None:  # noqa: B027  # TCP leaves nothing to remove
        """Remove the traces of the address, such as a path, when the cable is pulled."""

    @property
    def body(self) -> Body:
        """The robot's body. Raise ``ValueError`` for a robot without one."""
        return body_of(self._robot)

    def set_fault(self, text: str) -> None:
        """Set a fault, given as ``WORD`` or ``WORD:unit``. Raise ``ValueError`` for any other text."""
        self._robot.set_fault(*parse_fault(text))

    def power_cycle(self) -> None:
        self._robot.power_cycle()

    def plug(self) -> None:
        if not self._listeners:
            self._listeners = self.listen()
            self._plugged.set()

    def unplug(self) -> None:
        """Pull the cable. The robot does not notice it."""
        if self._plugged.is_set():  # Otherwise tasks already wait for this event.
            self._plugged = trio.Event()
        for listener in self._listeners:
            trio.lowlevel.notify_closing(listener)
            listener.close()
        self._listeners = []
        self.forget()
        for connection in list(self._connections):
            connection.abort()

    def freeze(self, seconds: float) -> None:
        """Stop reading and answering for so long. Then the robot handles the bytes that waited."""
        self._frost.freeze(seconds)

    def be_late(self, lateness: Lateness) -> None:
        """Delay the requests of one process, on its present and on new connections."""
        self._lateness = lateness
        for connection in self._connections:
            connection.be_late(lateness)

    async def serve(self) -> None:
        """Serve until cancelled."""
        async with trio.open_nursery() as nursery:
            for at in range(len(self._handlers)):
                nursery.start_soon(self._accept, at, nursery)

    def close(self) -> None:
        self.unplug()

    async def _accept(self, at: int, nursery: trio.Nursery) -> None:
        while True:
            await self._plugged.wait()
            if not self._listeners:  # The cable was pulled again before this task ran.
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
        """Reserve the ports, unplugged.

        Args:
            robot: The robot.
            handlers: Handlers by port number, 0 for any free port. The first port is the address.
            log: The wire log.
            host: Host address; by default an unused one for this twin.

        Raises:
            OSError: A port is in use.
        """
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
    """Return listeners for all ports on one host. If a random host is already in use, try another."""
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
    """Return a host address for one twin. On Linux every address 127.x.y.z is local; elsewhere only
    127.0.0.1 is."""
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
