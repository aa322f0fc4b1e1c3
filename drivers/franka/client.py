"""Connect to a Franka controller: send requests and receive replies on TCP, and receive states on UDP.

The wire process (the only writer to the robot) keeps one connection. The root process, which supervises it, opens
a connection to check that the arm stands still. No vendor library is used, so no call here can hang or hold the
interpreter's lock.
"""

from __future__ import annotations

import contextlib
import socket

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.receive_budget import ReceiveBudget
from strands_actors.drivers.common.ports.tcp_port import TcpPort, open_tcp
from strands_actors.kernel.processes.reserve import RESERVE

from . import protocol as p

ANSWER_S = 0.4
"""Timeout of a reply. A controller answers within milliseconds."""
FIRST_STATE_S = 0.4
ELSEWHERE_S = 0.1
"""Time in which a state from the address of the TCP connection is preferred to one from another address."""
LOOK_S = 0.002
"""Period of the checks for received data during a wait."""

STATES_SIZE = 256 * 1024
"""Most bytes of states in one turn: 64 states."""
CONNECT = 0
"""Number of the first request of a connection, ``connect``."""
MOST_KEPT = 64
"""Number of unread replies to keep. A newer reply replaces the oldest one."""

_DRIVERS = {5: "panda", 10: "fr3 or fr3_v2"}


class Fci:
    """A client of the controller. Its methods raise ``WireDown`` once the connection is lost."""

    def __init__(self, tcp: TcpPort, udp: socket.socket, dialect: p.Dialect) -> None:
        self._tcp = tcp
        self.udp = udp
        self.dialect = dialect
        self._budget = ReceiveBudget(tcp.name)
        self._states = ReceiveBudget(tcp.name, size=STATES_SIZE)
        self._decoder = p.Decoder(p.LARGEST_REPLY)
        self._id = -1
        self._sent_commands: dict[int, int] = {}  # The last requests: request number -> command code.
        self._waiting: list[p.Message] = []

    def send(self, name: str, payload: bytes = b"") -> int:
        """Send a request now. Return its number."""
        number = self._number(name)
        self._tcp.write(self.dialect.request(name, number, payload))
        return number

    def greet(self) -> None:
        """Send the request ``connect``, which must be the first request of a connection."""
        self._tcp.write(self._greeting())

    def greet_and_stop(self) -> int:
        """Send the requests ``connect`` and ``stop`` in one write, so that the stop does not wait for a reply.

        The controller carries out requests in the order in which they arrive [assumed]. Return the number of the
        stop request.
        """
        greeting, stop = self._greeting(), self._number("stop")
        self._tcp.write(greeting + self.dialect.request("stop", stop))
        return stop

    def _greeting(self) -> bytes:
        return self.dialect.connect(self._number("connect"), self.udp.getsockname()[1])

    def _number(self, name: str) -> int:
        self._id += 1
        self._sent_commands[self._id] = self.dialect.commands.index(name)
        if len(self._sent_commands) > MOST_KEPT:
            del self._sent_commands[next(iter(self._sent_commands))]
        return self._id

    def start_motion(self) -> int:
        """Request a motion by joint positions. Return the number of the request.

        The controller replies to it twice: at the start and at the end of the motion.
        """
        number = self._number("move")
        self._tcp.write(self.dialect.start_joint_motion(number))
        return number

    def replies(self) -> list[p.Message]:
        """Return the replies received since the last call. Never waits."""
        for data in self._budget.turn(self._tcp.read_waiting):
            try:
                # A reply repeats both the number and the command of its request.
                self._waiting.extend(
                    reply for reply in self._decoder.feed(data) if self._sent_commands.get(reply.id) == reply.code
                )
            except MalformedFrame as error:
                raise WireDown(f"{self._tcp.name}: {error}. Check that this is a Franka controller") from None
        waiting, self._waiting = self._waiting, []
        return waiting

    async def answer(self, request_id: int, name: str) -> p.Message:
        """Wait for the reply to a request. ``replies`` returns any other reply that arrives meanwhile."""
        with trio.move_on_after(ANSWER_S):
            while True:
                arrived = self.replies()
                reply = next((message for message in arrived if message.id == request_id), None)
                self._waiting = [message for message in arrived if message is not reply][-MOST_KEPT:]
                if reply is not None:
                    return reply
                await trio.sleep(LOOK_S)
        raise WireDown(
            f"{self._tcp.name}: the controller did not answer {name} within {ANSWER_S:g} s. Check its power"
        )

    async def handshake(self, robot: str) -> p.State:
        """Wait for the reply to ``connect``, then for the controller's first state.

        Raises:
            WireDown: One of them did not come, or the controller has another FCI version.
        """
        reply = await self.answer(CONNECT, "connect")
        try:
            status, version = p.connect_reply(reply)
        except MalformedFrame as error:
            raise WireDown(f"{self._tcp.name}: {error}. Check that this is a Franka controller") from None
        if status:
            hint = f"Use the {_DRIVERS[version]} driver" if version in _DRIVERS else "No driver here speaks it"
            raise WireDown(f"controller has FCI {version}, {robot} needs FCI {self.dialect.version}. {hint}")
        return await self._first_state()

    async def _first_state(self) -> p.State:
        """Return the controller's first state. From then on the UDP socket accepts datagrams only from its sender.

        A controller with several addresses may send its states from another one than that of the TCP connection, as
        libfranka allows. Such a state is used if none has come from the address of the connection in time.
        """
        host = self._tcp.peer_host
        elsewhere: tuple[p.State, tuple[str, int]] | None = None
        until_s = trio.current_time() + ELSEWHERE_S
        with trio.move_on_after(FIRST_STATE_S):
            while elsewhere is None or trio.current_time() < until_s:
                try:
                    data, source = self.udp.recvfrom(p.LARGEST_REQUEST)
                except BlockingIOError:
                    with trio.move_on_after(LOOK_S):
                        await trio.lowlevel.wait_readable(self.udp)
                    continue
                await trio.lowlevel.checkpoint()  # A flood of foreign datagrams must not block other tasks.
                if source[0] == host:
                    self.udp.connect(source)
                    try:
                        return self.dialect.state(data)
                    except MalformedFrame as error:
                        raise WireDown(f"{self._tcp.name}: {error}") from None
                if elsewhere is None:
                    with contextlib.suppress(MalformedFrame):
                        elsewhere = self.dialect.state(data), source
        if elsewhere is not None:
            state, source = elsewhere
            self.udp.connect(source)
            return state
        raise WireDown(
            f"{self._tcp.name}: connected, but no state within {FIRST_STATE_S:g} s. "
            "Activate FCI in Desk, and let UDP pass the firewall of this computer"
        )

    def newest_state(self) -> p.State | None:
        """Return the newest received state. Datagrams that are not states are ignored."""
        newest = None
        for data in self._states.turn(self._datagram):
            with contextlib.suppress(MalformedFrame):
                newest = self.dialect.state(data)
        return newest

    def _datagram(self) -> bytes | None:
        try:
            return self.udp.recv(p.LARGEST_REQUEST)
        except BlockingIOError:
            return None
        except OSError as error:
            raise WireDown(
                f"{self._tcp.name}: cannot receive the controller's states ({error.strerror}). Check the network"
            ) from None

    def close_in_order(self) -> None:
        """Close after the sent bytes are delivered, so that a frozen controller receives them when it continues."""
        self._tcp.close_in_order()
        self.udp.close()

    def close(self) -> None:
        self._tcp.close()
        self.udp.close()


def open_udp(tcp: TcpPort, host: str, sender: str) -> socket.socket:
    """Return a socket for the states of ``sender``, at the own address of a connection to ``host``.

    Raises:
        WireDown: The socket cannot be opened. The connection is closed then.
    """
    try:
        udp = socket.socket(type=socket.SOCK_DGRAM)
    except OSError as error:
        RESERVE.lacked(error)
        tcp.close()
        raise _no_udp_port(host, sender, error) from None
    try:
        udp.setblocking(False)
        udp.bind((tcp.own_host, 0))
        return udp
    except BaseException as error:
        tcp.close()
        udp.close()
        if isinstance(error, OSError):
            raise _no_udp_port(host, sender, error) from None
        raise


def _no_udp_port(host: str, sender: str, error: OSError) -> WireDown:
    return WireDown(f"{host}: cannot open a UDP port for the {sender}'s states ({error.strerror})")


async def open_client(host: str, fci: int) -> Fci:
    """Connect by TCP. Return a client that has sent nothing yet. Raise ``WireDown`` if that fails."""
    tcp = await open_tcp(host, p.PORT)
    return Fci(tcp, open_udp(tcp, host, "controller"), p.DIALECTS[fci])


async def connect(host: str, fci: int, robot: str) -> Fci:
    """Return a client that has received a state. Raise ``WireDown`` if that fails."""
    client = await open_client(host, fci)
    try:
        client.greet()
        await client.handshake(robot)
        return client
    except BaseException:
        client.close()
        raise
