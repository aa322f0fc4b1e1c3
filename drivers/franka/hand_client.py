"""Connect to the service of a Franka Hand: send requests and receive replies on TCP, and receive states on UDP."""

from __future__ import annotations

import contextlib
import socket

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.receive_budget import ReceiveBudget
from strands_actors.drivers.common.ports.tcp_port import TcpPort, open_tcp
from strands_actors.kernel.clock import NS, Clock

from . import hand_protocol as p
from .client import ANSWER_S, FIRST_STATE_S, LOOK_S, open_udp
from .hand_protocol import Command, HandState
from .protocol import Decoder

STILL_M, STANDS_S = 0.0003, 0.1
"""Fingers stand if their distance has not changed by more than this for so long [assumed]."""
MOST_KEPT = 16
"""Number of requests, and of replies, to keep. A newer one replaces the oldest one."""


class HandClient:
    """A client of the hand's service. Its methods raise ``WireDown`` once the connection is lost."""

    def __init__(self, tcp: TcpPort, udp: socket.socket, clock: Clock) -> None:
        self._tcp, self._udp, self._clock = tcp, udp, clock
        self._budget, self._states = ReceiveBudget(tcp.name), ReceiveBudget(tcp.name)
        self._decoder = Decoder(p.LARGEST_MESSAGE, p.HEADER)
        self._number = -1
        self._commands: dict[int, Command] = {}  # command of each request that has no reply yet, by number
        self.statuses: dict[int, int] = {}
        """Status of each reply, by the number of its request."""
        self.state: HandState | None = None
        self.stamp_ns = 0
        self._stood_at_m, self._moved_ns = 0.0, 0

    def send(self, command: Command, payload: bytes = b"") -> int:
        """Send a request now. Return its number."""
        self._number += 1
        self._commands[self._number] = command
        while len(self._commands) > MOST_KEPT:
            del self._commands[min(self._commands)]
        self._tcp.write(p.frame(command, self._number, payload))
        return self._number

    def look(self) -> None:
        """Take the replies and the states that have arrived. Never waits."""
        for data in self._budget.turn(self._tcp.read_waiting):
            try:
                for reply in self._decoder.feed(data):
                    # A reply repeats both the number and the command of its request.
                    if self._commands.get(reply.id) == reply.code:
                        del self._commands[reply.id]
                        self.statuses[reply.id] = p.status_of(reply)
            except MalformedFrame as error:
                raise WireDown(f"{self._tcp.name}: {error}. Check that this is a Franka Hand") from None
        while len(self.statuses) > MOST_KEPT:
            del self.statuses[min(self.statuses)]
        for data in self._states.turn(self._datagram):
            with contextlib.suppress(MalformedFrame):
                self._take(p.state(data))

    def stands(self, since_ns: int) -> bool:
        """Return whether a state that came after ``since_ns`` shows fingers that have stood for ``STANDS_S``."""
        return self.stamp_ns > since_ns and self.stamp_ns - self._moved_ns >= STANDS_S * NS

    def moved_since(self, since_ns: int) -> bool:
        return self._moved_ns > since_ns

    def _take(self, state: HandState) -> None:
        if self.state is not None and state.message_id <= self.state.message_id:
            return  # A hand that repeats itself, or an older datagram: its age shows that.
        now_ns = self._clock.now_ns()
        if self.state is None:
            self._stood_at_m = state.width_m
        elif abs(state.width_m - self._stood_at_m) > STILL_M:
            self._stood_at_m, self._moved_ns = state.width_m, now_ns
        self.state, self.stamp_ns = state, now_ns

    async def answer(self, number: int, command: Command) -> int:
        """Wait for the reply to a request that is answered at once. Return its status."""
        with trio.move_on_after(ANSWER_S):
            while number not in self.statuses:
                await trio.sleep(LOOK_S)
                self.look()
            return self.statuses.pop(number)
        raise WireDown(f"{self._tcp.name}: the hand did not answer {command.name.lower()} within {ANSWER_S:g} s")

    async def handshake(self) -> None:
        """Connect to the service, and wait for the first state."""
        connect = self.send(Command.CONNECT, p.connect_payload(self._udp.getsockname()[1]))
        if await self.answer(connect, Command.CONNECT) != p.ConnectStatus.SUCCESS:
            raise WireDown(f"{self._tcp.name}: the hand does not speak version {p.VERSION} of its protocol")
        with trio.move_on_after(FIRST_STATE_S):
            while self.state is None:
                await trio.sleep(LOOK_S)
                self.look()
        if self.state is None:
            raise WireDown(
                f"{self._tcp.name}: no state of the hand within {FIRST_STATE_S:g} s. "
                "Let UDP pass the firewall of this computer"
            )

    def _datagram(self) -> bytes | None:
        try:
            data, source = self._udp.recvfrom(p.LARGEST_MESSAGE)
        except BlockingIOError:
            return None
        except OSError as error:
            raise WireDown(f"{self._tcp.name}: cannot receive the hand's states ({error.strerror})") from None
        return data if source[0] == self._tcp.peer_host else b""

    def close_in_order(self) -> None:
        """Close after the sent bytes are delivered."""
        self._tcp.close_in_order()
        self._udp.close()

    def close(self) -> None:
        self._tcp.close()
        self._udp.close()


async def connect_hand(host: str, clock: Clock) -> HandClient:
    """Return a client that has received a state. Raise ``WireDown`` if that fails."""
    tcp = await open_tcp(host, p.PORT)
    client = HandClient(tcp, open_udp(tcp, host, "hand"), clock)
    try:
        await client.handshake()
        return client
    except BaseException:
        client.close()
        raise
