"""Simulate a robot on TCP ports, with any number of clients.

Every simulated robot has its own host address, 127.x.y.z, because several protocols have fixed port numbers.
Pulling the cable ends every connection, and new connections are refused. A frozen robot accepts connections and
does not answer.
"""

from __future__ import annotations

import contextlib
import os
import random
import socket
import struct
import sys
import time
from abc import abstractmethod
from collections.abc import Awaitable, Callable, Mapping, Sequence

import trio

from .lateness import Lateness
from .line import CHUNK
from .robot import Controls
from .server import Conversation, Frost, TwinServer, TwinSession
from .wirelog import WireLog

BACKLOG = 64
ATTEMPTS = 64
OFFERED_BYTES = 16 * 1024


class ClientGone(Exception):
    """Raised in a handler: the client has closed its connection, or the cable was pulled."""


class Connection:
    """The robot's end of the connection with one client. ``log_received`` and ``send_logged`` are for handlers that
    also send messages without a request."""

    def __init__(self, sock: socket.socket, log: WireLog, frost: Frost) -> None:
        self._sock = sock
        self.late_s = 0.0
        """Delay of the client's requests in seconds. Their order stays the same."""
        self.log = log
        self.frost = frost
        self._unsent = b""  # rest of an offered frame that was not sent yet
        self._offers = False

    @property
    def peer_host(self) -> str:
        """The client's IP address; empty after the client has disconnected."""
        try:
            return str(self._sock.getpeername()[0])
        except OSError:
            return ""

    def bits_per_s(self) -> int | None:
        return None

    def quiet_for(self, seconds: float) -> bool:
        # This function must not block, because other clients use the same event loop.
        return False

    async def receive(self) -> tuple[int, bytes]:
        """Wait for bytes. Return the time at which they were read, and the bytes. Raise ``ClientGone``."""
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
        """Send a frame without waiting. If it does not fit into the client's buffer, disconnect the client, because
        it could not decode a part of the frame."""
        try:
            sent = self._sock.send(data)
        except BlockingIOError:
            sent = 0
        except OSError:
            # The connection has ended. The next ``receive`` reports this.
            return
        if sent != len(data):
            self.abort()

    @property
    def takes(self) -> bool:
        """True if the last offered frame was sent completely, so that a new frame may be offered. Reading this
        property first tries to send the rest of the last frame."""
        if self._unsent:
            self._unsent = self._unsent[self.send_part(self._unsent) :]
        return not self._unsent

    def offer(self, data: bytes) -> None:
        """Send a frame that the client may ignore. As long as the client does not read, later frames are skipped,
        each as a whole."""
        # A small send buffer prevents megabytes from waiting for a client that does not read.
        if not self._offers:
            self._offers = True
            # This fails if the connection has ended. The next ``receive`` reports this.
            with contextlib.suppress(OSError):
                self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, OFFERED_BYTES)
        if self.takes:
            self._unsent = data[self.send_part(data) :]

    def send_part(self, data: bytes) -> int:
        """Send as many of these bytes as fit into the client's buffer, without waiting. Return their number."""
        try:
            return self._sock.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            # The connection has ended. The next ``receive`` reports this.
            return len(data)

    def log_received(self, t_ns: int, kind: str, data: bytes) -> None:
        """Log a frame that the client has sent."""
        self.log.write(t_ns, "host", [(kind, data)])

    def send_logged(self, kind: str, data: bytes) -> None:
        """Send a frame of the robot, and log it."""
        self.log.write(time.monotonic_ns(), "robot", [(kind, data)])
        self.send(data)

    def set_delay(self, lateness: Lateness) -> None:
        """Delay the requests of this client if ``lateness`` names its process."""
        self.late_s = lateness.of(self._sock)

    def hang_up(self) -> None:
        """Close the connection in order, so that all sent bytes still arrive."""
        if self._sock.fileno() >= 0:
            trio.lowlevel.notify_closing(self._sock)
            self._sock.close()

    def abort(self) -> None:
        """Close the connection with a reset. Does nothing if it is closed."""
        if self._sock.fileno() < 0:
            return
        with contextlib.suppress(OSError):
            self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        trio.lowlevel.notify_closing(self._sock)
        self._sock.close()


Handler = Callable[[Connection], Awaitable[None]]
"""Serves one client until ``ClientGone``, which it does not catch."""


def answering(new_session: Callable[[], TwinSession]) -> Handler:
    """Return a handler for a port on which the robot sends only replies."""

    async def handle(connection: Connection) -> None:
        await Conversation(new_session(), connection, connection.log, connection.frost).serve()

    return handle


class StreamServer(TwinServer):
    """Serve one simulated robot on several ports, each with its handler (the function that serves one connection).

    A test calls the public methods while the robot runs, for example to cut its connections or its power.
    """

    def __init__(self, robot: Controls, handlers: Sequence[Handler], log: WireLog) -> None:
        super().__init__(robot, log)
        self._handlers = list(handlers)
        self._connections: set[Connection] = set()
        self._lateness = Lateness()
        self._plugged = trio.Event()
        self._listeners: list[socket.socket] = []

    @abstractmethod
    def listen(self) -> list[socket.socket]:
        """Open a listener for each handler. Raise ``OSError``."""

    def forget(self) -> None:  # TCP leaves nothing to remove
        """Remove what is left of the server's address after the cable was pulled, such as the path of a unix
        socket."""

    def plug(self) -> None:
        if not self._listeners:
            self._listeners = self.listen()
            self._plugged.set()

    def unplug(self) -> None:
        # If the cable is already unplugged, tasks wait for the present event, so it must stay.
        if self._plugged.is_set():
            self._plugged = trio.Event()
        for listener in self._listeners:
            trio.lowlevel.notify_closing(listener)
            listener.close()
        self._listeners = []
        self.forget()
        for connection in list(self._connections):
            connection.abort()

    def set_delay(self, lateness: Lateness) -> None:
        """Delay the requests of one client process, on its open connections and on new ones."""
        self._lateness = lateness
        for connection in self._connections:
            connection.set_delay(lateness)

    def start(self, nursery: trio.Nursery) -> None:
        for index in range(len(self._handlers)):
            nursery.start_soon(self._accept, index, nursery)

    def close(self) -> None:
        self.unplug()

    async def _accept(self, index: int, nursery: trio.Nursery) -> None:
        while True:
            await self._plugged.wait()
            if not self._listeners:  # The cable was pulled again before this task ran.
                continue
            listener = self._listeners[index]
            with contextlib.suppress(BlockingIOError, ConnectionError, trio.ClosedResourceError):
                await trio.lowlevel.wait_readable(listener)
                await self._frost.thawed()
                if listener.fileno() >= 0:
                    sock, _ = listener.accept()
                    # It counts as connected before its task runs. Otherwise a cable that is pulled in between
                    # would leave it open.
                    nursery.start_soon(self._attend, self._connect(sock), self._handlers[index])

    def _connect(self, sock: socket.socket) -> Connection:
        sock.setblocking(False)
        if sock.family != socket.AF_UNIX:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection = Connection(sock, self._log, self._frost)
        connection.set_delay(self._lateness)
        self._connections.add(connection)
        return connection

    async def _attend(self, connection: Connection, handler: Handler) -> None:
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
        """Reserve the ports. The cable is not plugged in yet.

        Args:
            robot: The robot.
            handlers: Handlers by port number, 0 for any free port. Clients get the number of the first port.
            log: The log of the robot's protocol.
            host: Host address; by default an unused one for this robot.

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
    """Open a listener for each port on one host address. If a random host address is in use, try another."""
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
    """Return a host address for one simulated robot. On Linux every address 127.x.y.z is local; on other systems
    only 127.0.0.1 is."""
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
