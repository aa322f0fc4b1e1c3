"""A connection to a controller: requests and replies on TCP, and where its states arrive.

The wire process has one as long as the link is up, the root makes one when it has to see the arm
stand. No vendor's library: nothing here can hang, or hold the interpreter's lock.
"""

from __future__ import annotations

import contextlib
import socket

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.receive_budget import ReceiveBudget
from strands_actors.drivers.common.tcp_port import TcpPort, open_tcp
from strands_actors.kernel.processes.reserve import RESERVE

from . import protocol as p

ANSWER_S = 0.4
"""A controller answers within milliseconds."""
FIRST_STATE_S = 0.4
LOOK_S = 0.002
"""Between two looks at what has arrived, while somebody waits for it."""

STATES_SIZE = 256 * 1024
"""Bytes of one turn: 64 states."""
CONNECT = 0
"""Number of the greeting."""
MOST_KEPT = 64
"""Replies that nobody has taken yet; the oldest make room."""

_DRIVERS = {5: "panda", 10: "fr3 or fr3_v2"}


class Fci:
    """One client of the controller. Raises ``WireDown`` once it is gone."""

    def __init__(self, tcp: TcpPort, udp: socket.socket, dialect: p.Dialect) -> None:
        self._tcp = tcp
        self.udp = udp
        self.dialect = dialect
        self._budget = ReceiveBudget(tcp.name)
        self._states = ReceiveBudget(tcp.name, size=STATES_SIZE)
        self._decoder = p.Decoder(p.LARGEST_REPLY)
        self._id = -1
        self._asked: dict[int, int] = {}  # command by number, of the last requests
        self._waiting: list[p.Message] = []

    def send(self, name: str, payload: bytes = b"") -> int:
        """Send a request now; its number."""
        number = self._number(name)
        self._tcp.write(self.dialect.request(name, number, payload))
        return number

    def greet(self) -> None:
        """Say who we are: the first request of a connection."""
        self._tcp.write(self._greeting())

    def greet_and_stop(self) -> int:
        """Say who we are, and tell the arm to stop, in one write: the stop waits for no answer. The
        controller does what it is asked in the order in which it came [assumed]. Return the number of
        the stop."""
        greeting, stop = self._greeting(), self._number("stop")
        self._tcp.write(greeting + self.dialect.request("stop", stop))
        return stop

    def _greeting(self) -> bytes:
        return self.dialect.connect(self._number("connect"), self.udp.getsockname()[1])

    def _number(self, name: str) -> int:
        self._id += 1
        self._asked[self._id] = self.dialect.commands.index(name)
        if len(self._asked) > MOST_KEPT:
            del self._asked[next(iter(self._asked))]
        return self._id

    def start_motion(self) -> int:
        """Ask for a motion by joint positions; the number of the request. It is answered twice."""
        number = self._number("move")
        self._tcp.write(self.dialect.start_joint_motion(number))
        return number

    def replies(self) -> list[p.Message]:
        """Return what has arrived and nobody has taken. Never waits."""
        for data in self._budget.turn(self._tcp.read_waiting):
            try:
                # An answer names its question twice, by the number and by the command.
                self._waiting.extend(
                    message for message in self._decoder.feed(data) if self._asked.get(message.id) == message.code
                )
            except MalformedFrame as error:
                raise WireDown(f"{self._tcp.name}: {error}. Is this a Franka controller?") from None
        taken, self._waiting = self._waiting, []
        return taken

    async def answer(self, request_id: int, name: str) -> p.Message:
        """Wait for the reply to a request; others stay for ``replies``."""
        with trio.move_on_after(ANSWER_S):
            while True:
                arrived = self.replies()
                found = next((message for message in arrived if message.id == request_id), None)
                self._waiting = [message for message in arrived if message is not found][-MOST_KEPT:]
                if found is not None:
                    return found
                await trio.sleep(LOOK_S)
        raise WireDown(f"{self._tcp.name}: no answer to {name} within {ANSWER_S:g} s. Is the controller alive?")

    async def handshake(self, robot: str) -> p.State:
        """Wait for the answer to the greeting, and for the first state. Raise ``WireDown``."""
        reply = await self.answer(CONNECT, "connect")
        try:
            status, version = p.connect_reply(reply)
        except MalformedFrame as error:
            raise WireDown(f"{self._tcp.name}: {error}. Is this a Franka controller?") from None
        if status:
            other = f"use the {_DRIVERS[version]} driver" if version in _DRIVERS else "no driver here speaks it"
            raise WireDown(f"controller speaks {version}, {robot} speaks {self.dialect.version}. {other}")
        return await self._first_state()

    async def _first_state(self) -> p.State:
        """Take states of this controller alone from now on."""
        host = self._tcp.peer_host
        with trio.move_on_after(FIRST_STATE_S):
            while True:
                try:
                    data, source = self.udp.recvfrom(p.LARGEST_REQUEST)
                except BlockingIOError:
                    await trio.lowlevel.wait_readable(self.udp)
                    continue
                await trio.lowlevel.checkpoint()  # a flood of others' datagrams takes no turn from others
                if source[0] == host:
                    self.udp.connect(source)
                    try:
                        return self.dialect.state(data)
                    except MalformedFrame as error:
                        raise WireDown(f"{self._tcp.name}: {error}") from None
        raise WireDown(
            f"{self._tcp.name}: connected, but no state within {FIRST_STATE_S:g} s. "
            "Is FCI activated in Desk? Does a firewall keep UDP away?"
        )

    def newest_state(self) -> p.State | None:
        """Return the newest state that has arrived. Of what is none nothing is taken."""
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
            raise WireDown(f"{self._tcp.name}: states do not arrive any more ({error.strerror})") from None

    def close_in_order(self) -> None:
        """As ``close``, but what was sent last is still delivered: a frozen controller finds it
        when it goes on."""
        self._tcp.close_in_order()
        self.udp.close()

    def close(self) -> None:
        self._tcp.close()
        self.udp.close()


async def open_client(host: str, fci: int) -> Fci:
    """Return a client that has said nothing yet. Raise ``WireDown``."""
    tcp = await open_tcp(host, p.PORT)
    try:
        udp = socket.socket(type=socket.SOCK_DGRAM)
    except OSError as error:
        RESERVE.lacked(error)
        tcp.close()
        raise WireDown(f"{host}: no UDP port for its states ({error.strerror})") from None
    client = Fci(tcp, udp, p.DIALECTS[fci])
    try:
        udp.setblocking(False)
        udp.bind((tcp.own_host, 0))
        return client
    except BaseException as error:
        client.close()
        if isinstance(error, OSError):
            raise WireDown(f"{host}: no UDP port for its states ({error.strerror})") from None
        raise


async def connect(host: str, fci: int, robot: str) -> Fci:
    """Return a client that has heard a state. Raise ``WireDown``."""
    client = await open_client(host, fci)
    try:
        client.greet()
        await client.handshake(robot)
        return client
    except BaseException:
        client.close()
        raise
