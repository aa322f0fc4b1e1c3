"""Serve a simulated Franka Hand: its requests on TCP port 1338, and its states on UDP."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.twin import ClientGone, Connection
from strands_actors.drivers.franka import hand_protocol as p
from strands_actors.drivers.franka.hand_protocol import Command, ConnectStatus, Status
from strands_actors.drivers.franka.protocol import Decoder, Message

from .hand import REQUESTS, Hand

STATE_S = 1 / 60
"""Time between two states [assumed]."""
KINDS: Mapping[int, str] = {
    Command.MOVE: "setpoint",
    Command.GRASP: "setpoint",
    Command.HOMING: "setpoint",
    Command.STOP: "safe",
}


class HandService:
    """The service of a hand.

    Args:
        hand: The hand.
        send: Send a state to the address of a client.
    """

    def __init__(self, hand: Hand, send: Callable[[bytes, tuple[str, int]], None]) -> None:
        self.hand = hand
        self._send = send
        self._listeners: dict[Connection, tuple[str, int]] = {}
        self._due_s = 0.0

    async def attend(self, connection: Connection) -> None:
        """Serve one client. Its motion goes on if it goes away [assumed]."""
        decoder = Decoder(p.LARGEST_MESSAGE, p.HEADER)
        try:
            while True:
                t_ns, data = await connection.receive()
                for message in decoder.feed(data):
                    kind = KINDS.get(message.code, "config" if message.code in REQUESTS else "other")
                    raw = p.frame(message.code, message.id, message.payload)
                    # A stop of the hand is no safe state of the arm.
                    connection.log.write(t_ns, "host", [(kind, raw)], "" if kind == "safe" else None)
                    if not self.hand.is_lost:
                        self._obey(connection, message)
        except MalformedFrame:
            raise ClientGone from None
        finally:
            self._listeners.pop(connection, None)

    def _obey(self, connection: Connection, message: Message) -> None:
        if message.code not in REQUESTS:
            raise ClientGone
        command = Command(message.code)
        if command is Command.CONNECT:
            if len(message.payload) != p.CONNECT.size:
                raise ClientGone
            version, port = p.CONNECT.unpack(message.payload)
            matches = version == p.VERSION
            if matches:
                self._listeners[connection] = connection.peer_host, port
            status = ConnectStatus.SUCCESS if matches else ConnectStatus.INCOMPATIBLE
            _reply(connection, command, message.id, p.CONNECT.pack(status, p.VERSION))
        elif connection not in self._listeners:
            raise ClientGone  # The first request must be ``CONNECT``.
        elif command is Command.STOP:
            self.hand.stop()
            self.report()
            _reply(connection, command, message.id, _status(Status.SUCCESS))
        else:
            refused = self.hand.begin(connection, command, message.id, message.payload)
            if refused is not None:
                _reply(connection, command, message.id, _status(refused))

    def report(self) -> None:
        """Send the replies to requests that have ended, and the states that are due."""
        ended, self.hand.ended = self.hand.ended, []
        for client, command, number, status in ended:
            if client in self._listeners and not self.hand.is_lost:
                _reply(client, command, number, _status(status))
        now_s = time.monotonic()
        if now_s < self._due_s or self.hand.is_lost:
            return
        self._due_s = now_s + STATE_S
        for address in self._listeners.values():
            # Ignore a client with a full buffer. If the client has gone, its TCP connection shows that.
            with contextlib.suppress(OSError):
                self._send(self.hand.state(), address)


def _status(status: Status) -> bytes:
    return int(status).to_bytes(2, "little")


def _reply(connection: Connection, command: Command, number: int, payload: bytes) -> None:
    connection.send_logged("read", p.frame(command, number, payload))
