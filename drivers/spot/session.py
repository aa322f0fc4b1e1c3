"""A login at a Spot: one connection for each authority (host name of a group of services), a token,
and calls with a deadline each.

This module repeats no request by itself, and keeps no login alive.
"""

from __future__ import annotations

import hashlib
import socket
import time
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.codecs.grpc_messages import ClientEnd, Header
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.grpc import Call, CallFailed, Connection, Stream
from strands_actors.drivers.common.ports.tls_port import open_tls
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from .config import SpotConfig
from .messages import Message

CONNECT_S = 1.0
"""Longest time to connect, TLS and HTTP/2 included."""
ANSWER_S = 0.3
"""Longest time for an answer, by default. The vendor's client waits 30 s."""
LOGIN_S = 2.0
"""Longest time for the answer to a login."""
RENEW_S = 3600.0
"""Age at which a token is renewed. It is valid for 12 h."""
RENEW_AGAIN_S = 60.0
"""Pause between two attempts to renew it."""
TOKEN_S = 11 * 3600.0
"""Age at which a token that could not be renewed ends the session."""


class NoAnswer(WireDown):
    """The robot has not answered a request in time. It may still carry out the request."""


class OpenStream(Protocol):
    """A function that opens a stream of bytes to an authority (the host name of a group of services). Raises
    ``WireDown``."""

    async def __call__(self, authority: str, /) -> Stream: ...


class SentRequest:
    """A request that was sent, to wait for its answer."""

    def __init__(self, method: p.Method, call: Call, connection: Connection) -> None:
        self.method = method
        self.call = call
        self.connection = connection


class SpotSession:
    """A login at the robot with its connections.

    Args:
        config: Address and login.
        clock: The clock of this process.
        open_stream: Opens a connection. Only tests give it; the default is TLS to the address of
            ``config``.
    """

    def __init__(self, config: SpotConfig, clock: Clock, open_stream: OpenStream | None = None) -> None:
        self._config = config
        self._clock = clock
        self._open_stream = open_stream or self._open_tls
        self._connections: dict[str, Connection] = {}
        self._authorities = dict(p.AUTHORITIES)
        self._token = ""
        self._began_ns = clock.now_ns()
        self._epoch_ns = time.time_ns() - self._began_ns
        self.client = own_name()
        """Our client name at the robot. A lease or an e-stop endpoint with this name is ours."""
        self._token_ns = self._tried_ns = 0

    def host_ns(self) -> int:
        """Return the host's time that the robot is given. It starts at the host's clock and then
        runs evenly, even when the host's clock is set."""
        return self._epoch_ns + self._clock.now_ns()

    async def open(self, services: Sequence[str]) -> None:
        """Log in, read the directory, and connect to ``services`` now, so that no later call waits
        for a connection. Raise ``WireDown``."""
        await self.log_in()
        listed = await self.call("ListServiceEntries", {}, CONNECT_S)
        for entry in listed.get("service_entries", ()):
            if entry.get("name") in p.SERVICES and entry.get("authority"):
                self._authorities[entry["name"]] = entry["authority"]
        for service in services:
            await self._connect(self._authority(service))

    async def log_in(self) -> None:
        """Log in and get a token. Raise ``WireDown`` if the login fails."""
        self._tried_ns = self._clock.now_ns()
        user, password = self._config.login()
        try:
            answer = await self.call("GetAuthToken", {"username": user, "password": password}, LOGIN_S)
        finally:
            self._disconnect(p.AUTHORITIES["auth"])
        status = answer.get("status", 0)
        if status != p.OK or not answer.get("token"):
            reason = p.LOGIN_STATUS.get(status, f"status {status}")
            raise WireDown(f"login: {reason}. Check BOSDYN_CLIENT_USERNAME and BOSDYN_CLIENT_PASSWORD")
        self._token = answer["token"]
        self._token_ns = self._clock.now_ns()

    async def renew(self) -> None:
        """Get a new token if that is due. This may take as long as a login. It may fail for a while, since
        the old token is valid for hours. Raise ``WireDown`` when the token is too old."""
        now_ns = self._clock.now_ns()
        age_s, since_s = (now_ns - self._token_ns) / NS, (now_ns - self._tried_ns) / NS
        if age_s < RENEW_S or since_s < RENEW_AGAIN_S:
            return
        try:
            await self.log_in()
        except WireDown:
            if age_s >= TOKEN_S:
                raise

    async def call(self, name: str, body: Mapping[str, object], within_s: float = ANSWER_S) -> Message:
        """Send a request and return its answer. Connect first if that is needed.

        Raises:
            NoAnswer: No answer came within ``within_s`` seconds.
            WireDown: The call failed in another way.
        """
        await self._connect(self._authority(p.METHODS[name].service))
        return await self.answer(self.ask(name, body), within_s)

    async def connect_without_answer(self, service: str) -> None:
        """Connect without waiting for the server's first message. A stop uses this when the robot
        may understand us although its answers are unreadable. Raise ``WireDown``."""
        await self._connect(self._authority(service), settle=False)

    def ask(self, name: str, body: Mapping[str, object], permit: Permit | None = None) -> SentRequest:
        """Send a request now.

        Args:
            name: The method.
            body: The fields of the request, without its header.
            permit: The right to send, which is checked immediately before the request is sent.

        Raises:
            WireDown: It could not be sent, or there is no connection.
        """
        method = p.METHODS[name]
        connection = self._connections.get(self._authority(method.service))
        if connection is None or not connection.is_open:
            raise WireDown(f"{name}: the robot is not connected. Reconnect")
        data = p.request(method, body, self.client, self.host_ns())
        if permit is not None:
            permit.check()
        return SentRequest(method, connection.ask(method.path, data), connection)

    async def answer(self, request: SentRequest, within_s: float = ANSWER_S) -> Message:
        """Return the answer to a request that was sent.

        Raises:
            NoAnswer: No answer came within ``within_s`` seconds.
            WireDown: The call failed in another way.
        """
        name = request.method.name
        try:
            data = await request.connection.answer(request.call, within_s)
            if data is None:
                reason = f"{name}: {request.connection.name} has not answered within {within_s * 1e3:.0f} ms"
                raise NoAnswer(f"{reason}. Check the robot and its network")
            return p.reply(request.method, data)
        except CallFailed as failed:
            raise WireDown(f"{request.connection.name}: {failed}") from None
        except MalformedFrame as malformed:
            raise WireDown(f"{request.connection.name}: {malformed}") from None

    def close(self) -> None:
        for authority in list(self._connections):
            self._disconnect(authority)

    def close_in_order(self) -> None:
        """Close as ``close`` does, but without dropping sent data. A stop needs this."""
        for connection in self._connections.values():
            connection.close_in_order()
        self._connections.clear()

    def _authority(self, service: str) -> str:
        return self._authorities.get(service, p.AUTHORITIES["directory"])

    def _disconnect(self, authority: str) -> None:
        connection = self._connections.pop(authority, None)
        if connection is not None:
            connection.close()

    async def _connect(self, authority: str, settle: bool = True) -> None:
        connected = self._connections.get(authority)
        if connected is not None and connected.is_open:
            return
        self._disconnect(authority)
        stream = await self._open_stream(authority)
        is_ready = False
        try:
            end = _End(authority, lambda: self._token)
            stream.write(end.outgoing())
            connection = Connection(f"{self._config.address().host} ({authority})", stream, end)
            is_ready = not settle or await connection.until(lambda: end.settled, CONNECT_S)
            if is_ready:
                self._connections[authority] = connection
        finally:
            if not is_ready:
                stream.close()
        if not is_ready:
            raise NoAnswer(
                f"{authority}: the robot does not answer in gRPC within {CONNECT_S:g} s. Check port=, and the robot"
            )

    async def _open_tls(self, authority: str, /) -> Stream:
        address = self._config.address()
        return await open_tls(address.host, address.port, self._config.tls(), authority, within_s=CONNECT_S)


def own_name(machine_id: Path = Path("/etc/machine-id")) -> str:
    """Return the name by which this machine logs in. It contains a part of the machine id, because
    hosts often share a name. A machine must not take another machine's lease for its own."""
    try:
        number = machine_id.read_bytes().strip()
    except OSError:
        number = uuid.getnode().to_bytes(6, "big")
    return f"strands-actors {socket.gethostname()} {hashlib.sha256(number).hexdigest()[:8]}"


class _End(ClientEnd):
    """The client side of a gRPC connection to the robot. It sends the login token with each call."""

    def __init__(self, authority: str, token: _Token) -> None:
        super().__init__(authority, "https")
        self._token = token

    def call(self, path: str, metadata: Sequence[Header] = ()) -> int:
        token = self._token()
        return super().call(path, (*metadata, ("authorization", f"Bearer {token}")) if token else metadata)


class _Token(Protocol):
    def __call__(self) -> str: ...
