"""A login at a Spot: one connection for each authority, a token, and calls with a deadline each.

Nothing here repeats anything, or keeps anything alive.
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
from strands_actors.drivers.common.grpc import Call, CallFailed, Connection, Stream
from strands_actors.drivers.common.grpc_messages import ClientEnd, Header
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.tls_port import open_tls
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from .config import SpotConfig
from .messages import Message

CONNECT_S = 1.0
"""Within which a connection stands, TLS and HTTP/2 included."""
ANSWER_S = 0.3
"""Within which a call is answered, where nobody says otherwise. The vendor's client waits 30 s."""
LOGIN_S = 2.0
"""Within which a login is answered."""
RENEW_S = 3600.0
"""A token is renewed when it is as old; it is good for 12 h."""
RENEW_AGAIN_S = 60.0
"""Between two attempts at it."""
TOKEN_S = 11 * 3600.0
"""One that is as old, and could not be renewed, is not relied on any more."""


class NoAnswer(WireDown):
    """The robot has not answered in time. What it was told it may still do."""


class OpenStream(Protocol):
    """How a connection of bytes is made. Raises ``WireDown``."""

    async def __call__(self, authority: str, /) -> Stream: ...


class Asked:
    """A question that was sent."""

    def __init__(self, method: p.Method, call: Call, connection: Connection) -> None:
        self.method = method
        self.call = call
        self.connection = connection


class SpotSession:
    """``open_stream``: for tests; default TLS to the address of ``config``."""

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
        """The name under which the robot knows us: a lease or an e-stop endpoint of this name is
        ours."""
        self._token_ns = self._tried_ns = 0

    def host_ns(self) -> int:
        """Return the host's time, as the robot is told it: from its own beginning on it runs
        evenly, whoever sets the host's clock."""
        return self._epoch_ns + self._clock.now_ns()

    async def open(self, services: Sequence[str]) -> None:
        """Log in, read the directory, and connect to these services, so that none waits for a
        connection later. Raise ``WireDown``."""
        await self.log_in()
        listed = await self.call("ListServiceEntries", {}, CONNECT_S)
        for entry in listed.get("service_entries", ()):
            if entry.get("name") in p.SERVICES and entry.get("authority"):
                self._authorities[entry["name"]] = entry["authority"]
        for service in services:
            await self._connect(self._authority(service))

    async def log_in(self) -> None:
        """Get a token. Raise ``WireDown``."""
        self._tried_ns = self._clock.now_ns()
        user, password = self._config.login()
        try:
            told = await self.call("GetAuthToken", {"username": user, "password": password}, LOGIN_S)
        finally:
            self._leave(p.AUTHORITIES["auth"])
        status = told.get("status", 0)
        if status != p.OK or not told.get("token"):
            why = p.LOGIN_STATUS.get(status, f"status {status}")
            raise WireDown(f"login: {why}. Check BOSDYN_CLIENT_USERNAME and BOSDYN_CLIENT_PASSWORD")
        self._token = told["token"]
        self._token_ns = self._clock.now_ns()

    async def renew(self) -> None:
        """Get a new token when that is due. It may take as long as a login, and need not succeed at
        once: the old one is good for hours. Raise ``WireDown`` when it runs out."""
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
        """Ask and wait; connect first where that is needed. Raise ``NoAnswer`` when none comes in
        time, ``WireDown`` for all else."""
        await self._connect(self._authority(p.METHODS[name].service))
        return await self.answer(self.ask(name, body), within_s)

    async def connect_unheard(self, service: str) -> None:
        """Connect, and wait for nothing that the robot says, for a stop that it may understand when
        its answers cannot be. Raise ``WireDown``."""
        await self._connect(self._authority(service), settle=False)

    def ask(self, name: str, body: Mapping[str, object], permit: Permit | None = None) -> Asked:
        """Send a question now; ``permit`` is checked directly before. Raise ``WireDown``, also when
        there is no connection."""
        method = p.METHODS[name]
        connection = self._connections.get(self._authority(method.service))
        if connection is None or not connection.is_open:
            raise WireDown(f"{name}: the robot is not connected. Reconnect")
        data = p.request(method, body, self.client, self.host_ns())
        if permit is not None:
            permit.check()
        return Asked(method, connection.ask(method.path, data), connection)

    async def answer(self, asked: Asked, within_s: float = ANSWER_S) -> Message:
        """Return the answer. Raise ``NoAnswer`` when none comes in time, ``WireDown`` for all
        else."""
        name = asked.method.name
        try:
            data = await asked.connection.answer(asked.call, within_s)
            if data is None:
                why = f"{name}: {asked.connection.name} has not answered within {within_s * 1e3:.0f} ms"
                raise NoAnswer(f"{why}. Check the robot and its network")
            return p.reply(asked.method, data)
        except CallFailed as failed:
            raise WireDown(f"{asked.connection.name}: {failed}") from None
        except MalformedFrame as malformed:
            raise WireDown(f"{asked.connection.name}: {malformed}") from None

    def close(self) -> None:
        for authority in list(self._connections):
            self._leave(authority)

    def close_in_order(self) -> None:
        """As ``close``, but what was sent still arrives: for a stop."""
        for connection in self._connections.values():
            connection.close_in_order()
        self._connections.clear()

    def _authority(self, service: str) -> str:
        return self._authorities.get(service, p.AUTHORITIES["directory"])

    def _leave(self, authority: str) -> None:
        connection = self._connections.pop(authority, None)
        if connection is not None:
            connection.close()

    async def _connect(self, authority: str, settle: bool = True) -> None:
        known = self._connections.get(authority)
        if known is not None and known.is_open:
            return
        self._leave(authority)
        stream = await self._open_stream(authority)
        kept = False
        try:
            end = _End(authority, lambda: self._token)
            stream.write(end.outgoing())
            connection = Connection(f"{self._config.address().host} ({authority})", stream, end)
            kept = not settle or await connection.until(lambda: end.settled, CONNECT_S)
            if kept:
                self._connections[authority] = connection
        finally:
            if not kept:
                stream.close()
        if not kept:
            raise NoAnswer(
                f"{authority}: it does not speak gRPC within {CONNECT_S:g} s. Check port=, and the robot"
            )

    async def _open_tls(self, authority: str, /) -> Stream:
        address = self._config.address()
        return await open_tls(address.host, address.port, self._config.tls(), authority, within_s=CONNECT_S)


def own_name(machine_id: Path = Path("/etc/machine-id")) -> str:
    """Return what this machine is called: hosts of one name are common, and one of them must not
    take the other's lease for its own."""
    try:
        number = machine_id.read_bytes().strip()
    except OSError:
        number = uuid.getnode().to_bytes(6, "big")
    return f"strands-actors {socket.gethostname()} {hashlib.sha256(number).hexdigest()[:8]}"


class _End(ClientEnd):
    """Sends the token with each call."""

    def __init__(self, authority: str, token: _Token) -> None:
        super().__init__(authority, "https")
        self._token = token

    def call(self, path: str, metadata: Sequence[Header] = ()) -> int:
        token = self._token()
        return super().call(path, (*metadata, ("authorization", f"Bearer {token}")) if token else metadata)


class _Token(Protocol):
    def __call__(self) -> str: ...
