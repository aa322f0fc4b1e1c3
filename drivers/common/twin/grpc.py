"""Simulate a robot behind a gRPC service. Faults can damage or delay its messages.

The service handles received messages one after the other, in their order on the connection. It answers each one at
once, or later in a control cycle.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Protocol

from strands_actors.drivers.common.codecs.grpc_messages import (
    MAX_MESSAGE,
    Called,
    Ended,
    HalfClosed,
    MessageReceived,
    PeerLeft,
    ServerEnd,
    Status,
)
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from .faults import DELAYED_S, SLOW_S, Fault, Faults, Reply
from .tcp import ClientGone, Connection

_LATER_S = {Fault.SLOW: SLOW_S, Fault.DELAYED: DELAYED_S}


class ServerCall:
    """One gRPC call of a client, as the server sees it."""

    def __init__(self, client: GrpcClient, path: str, stream: int) -> None:
        self.client = client
        self.path = path
        self._stream = stream
        self.is_open = True

    @property
    def has_room(self) -> bool:
        """True if the client has read so much that no data waits for it. If False, a sample should be skipped."""
        return self.is_open and self.client.end.has_room(self._stream)

    def log_received(self, t_ns: int, kind: str, message: bytes, safe_state: str | None = None) -> None:
        """Log a message that the client has sent, without its HTTP/2 frame."""
        self.client.connection.log.write(t_ns, "host", [(kind, message)], safe_state)

    def send(self, message: bytes) -> None:
        """Send a message. Does nothing after the end of the call. A client that does not read is disconnected."""
        try:
            self.client.end.send(self._stream, message)
        except MalformedFrame:
            self.client.connection.abort()

    def end(self, status: Status = Status.OK, text: str = "") -> None:
        """End the call. Does nothing if it has ended, also by the client, whose connection may be closed."""
        if not self.is_open:
            return
        self.is_open = False
        self.client.end.end(self._stream, status, text)

    def answer(self, message: bytes) -> None:
        """Send the answer of a unary call (a call with a single answer), and end the call."""
        if self.client.service.faults.apply(Reply(0.0, b"")) is not None:
            self.send(message)
            self.end()


class GrpcService(Protocol):
    """A simulated gRPC service. One object serves all clients."""

    faults: Faults

    def called(self, call: ServerCall) -> bool:
        """Handle the begin of a call. Return False if there is no such method."""
        ...

    def message(self, call: ServerCall, t_ns: int, message: bytes) -> None:
        """Handle a message of the call, which was read at ``t_ns``. If this raises ``MalformedFrame``, the call
        ends with the status INTERNAL."""
        ...

    def over(self, call: ServerCall) -> None:
        """Handle the end of the client's messages. ``call.is_open`` is False if the client has cancelled the call
        or has disconnected."""
        ...


class GrpcClient:
    """One connection."""

    def __init__(self, service: GrpcService, connection: Connection, max_message: int) -> None:
        self.service = service
        self.connection = connection
        self.end = ServerEnd(max_message)
        self._calls: dict[int, ServerCall] = {}
        self._leaving: deque[tuple[float, bytes]] = deque()

    def take(self, t_ns: int, data: bytes) -> None:
        """Handle received bytes. Raise ``ClientGone`` if they are malformed, or if the client closes the
        connection."""
        try:
            events = self.end.feed(data)
        except MalformedFrame:
            raise ClientGone from None
        for event in events:
            match event:
                case Called(stream, path):
                    call = self._calls[stream] = ServerCall(self, path, stream)
                    if not self.service.called(call):
                        call.end(Status.UNIMPLEMENTED, f"no method {path}")
                case MessageReceived(stream, message) if self._open(stream):
                    self._message(self._calls[stream], t_ns, message)
                case HalfClosed(stream) if self._open(stream):
                    self.service.over(self._calls[stream])
                case Ended(stream) if stream in self._calls:
                    self._end(self._calls.pop(stream))
                case PeerLeft():
                    raise ClientGone

    def flush(self) -> None:
        """Send the waiting bytes. A fault may delay or damage them. Their order stays the same, as HTTP/2
        requires."""
        for stream in [stream for stream, call in self._calls.items() if not call.is_open]:
            del self._calls[stream]
        now_s = time.monotonic()
        data = self.end.outgoing()
        if data:
            self._leaving.append((now_s + self._delay_s(), self._damaged(data)))
        while self._leaving and self._leaving[0][0] <= now_s:
            self.connection.send(self._leaving.popleft()[1])

    def close(self) -> None:
        """End all calls, because the client has disconnected."""
        for call in self._calls.values():
            self._end(call)
        self._calls.clear()

    def _open(self, stream: int) -> bool:
        return stream in self._calls and self._calls[stream].is_open

    def _message(self, call: ServerCall, t_ns: int, message: bytes) -> None:
        try:
            self.service.message(call, t_ns, message)
        except MalformedFrame as malformed:
            call.end(Status.INTERNAL, str(malformed))
            self.service.over(call)

    def _end(self, call: ServerCall) -> None:
        if call.is_open:
            call.is_open = False
            self.service.over(call)

    def _delay_s(self) -> float:
        return _LATER_S.get(self.service.faults.of(None), 0.0)

    def _damaged(self, data: bytes) -> bytes:
        garbage = self.service.faults.of(None) is Fault.GARBAGE
        return bytes(byte ^ 0xA5 for byte in data) if garbage else data


class GrpcHost:
    """All clients of one simulated gRPC service."""

    def __init__(self, service: GrpcService, max_message: int = MAX_MESSAGE) -> None:
        self._service = service
        self._max_message = max_message
        self._clients: set[GrpcClient] = set()

    async def serve(self, connection: Connection) -> None:
        """Serve one client until it disconnects. The port of the service uses this as its ``Handler``."""
        client = self._client_of(connection)
        self._clients.add(client)
        try:
            client.flush()
            while True:
                t_ns, data = await connection.receive()
                client.take(t_ns, data)
                client.flush()
        finally:
            self._clients.discard(client)
            client.close()

    def _client_of(self, connection: Connection) -> GrpcClient:
        """Return a new client. A subclass may return one that checks its calls first."""
        return GrpcClient(self._service, connection, self._max_message)

    def flush(self) -> None:
        """Send the messages that the service has produced since the last call of ``flush``. Call it in every
        control cycle."""
        for client in list(self._clients):
            client.flush()
