"""The login at the simulated Spot: one user with a password, and the tokens that it hands out.

A call without a valid token ends with the gRPC status UNAUTHENTICATED, which the vendor's client reports as
``UnauthenticatedError``. The services that a client needs before its login (auth, robot-id) need no token, as the
robot's directory states for each service.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import h2.events

from strands_actors.drivers.common.codecs.grpc_messages import MAX_MESSAGE, Event, ServerEnd, Status, framed
from strands_actors.drivers.common.twin import Connection
from strands_actors.drivers.common.twin.grpc import GrpcClient, GrpcHost, GrpcService
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message

from .tls import TlsConnection

INVALID_LOGIN, INVALID_TOKEN = 2, 3
"""Statuses of ``GetAuthTokenResponse``."""
TOKEN_S = 12 * 3600.0
"""How long a token is valid."""
OPEN_SERVICES = ("auth", "robot-id")
"""Services that need no token."""

_OPEN_PATHS = frozenset(method.path for method in p.METHODS.values() if method.service in OPEN_SERVICES)
_SCHEME = "bearer "
_USUAL = 1 << 19
"""Length of a message, bytes, that the base class sends in any case."""


class Logins:
    """The permitted user, and the tokens in use.

    Args:
        now_s: The monotonic clock.
        user: The only user.
        password: The user's password.
    """

    def __init__(self, now_s: Callable[[], float], user: str, password: str) -> None:
        self._now_s = now_s
        self._login = (user, password)
        self._made_s: dict[str, float] = {}

    def log_in(self, request: Message) -> Message:
        """Return the reply to ``GetAuthToken``: a new token, for the user's password or for a valid token."""
        if "token" in request and "password" not in request:
            if not self.is_valid(request["token"]):
                return {"status": INVALID_TOKEN}
        elif (request.get("username"), request.get("password")) != self._login:
            return {"status": INVALID_LOGIN}
        token = f"twin-token-{len(self._made_s) + 1}"
        self._made_s[token] = self._now_s()
        return {"status": p.OK, "token": token}

    def is_valid(self, token: str) -> bool:
        made_s = self._made_s.get(token)
        return made_s is not None and self._now_s() - made_s < TOKEN_S

    def allows(self, path: str, authorization: str) -> bool:
        """Return True if a call may begin.

        Args:
            path: The path of the method.
            authorization: The header field of this name; empty if it is missing.
        """
        if path in _OPEN_PATHS:
            return True
        has_scheme = authorization.lower().startswith(_SCHEME)
        return has_scheme and self.is_valid(authorization[len(_SCHEME) :])


class LoginClient(GrpcClient):
    """One connection of a client. Its calls need a token."""

    def __init__(
        self, service: GrpcService, connection: Connection, logins: Logins, max_message: int = MAX_MESSAGE
    ) -> None:
        super().__init__(service, connection, max_message)
        self.end = _LoginEnd(logins, max_message)

    def flush(self) -> None:
        super().flush()
        if isinstance(self.connection, TlsConnection):
            self.connection.push()


class LoginHost(GrpcHost):
    """All clients of the simulated Spot."""

    def __init__(self, service: GrpcService, logins: Logins) -> None:
        super().__init__(service)
        self._logins = logins

    def _client_of(self, connection: Connection) -> GrpcClient:
        return LoginClient(self._service, connection, self._logins, self._max_message)


class _LoginEnd(ServerEnd):
    """The server side of a gRPC connection. It ends calls without a valid token before the service sees them."""

    def __init__(self, logins: Logins, max_message: int) -> None:
        super().__init__(max_message)
        self._logins = logins

    def send(self, stream: int, message: bytes) -> None:
        """Send one message. An answer with pictures may be longer than what the base class lets wait."""
        if len(message) < _USUAL or stream not in self._decoders or not self.has_room(stream):
            super().send(stream, message)
            return
        self._answer(stream)
        self._waiting[stream] = framed(message)
        self._flush(stream)

    def _events_of(self, event: h2.events.Event) -> Iterator[Event]:
        if not isinstance(event, h2.events.RequestReceived):
            yield from super()._events_of(event)
            return
        fields = {_text(name): _text(value) for name, value in event.headers or ()}
        if self._logins.allows(fields.get(":path", ""), fields.get("authorization", "")):
            yield from super()._events_of(event)
            return
        stream = event.stream_id
        assert stream is not None
        self._begin(stream)
        self.end(stream, Status.UNAUTHENTICATED, "the call has no valid token")


def _text(value: str | bytes) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value
