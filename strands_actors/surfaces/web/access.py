"""Decide which requests of a browser are allowed. Pure: the caller passes the time.

Another web page that is open in the same browser can send requests to this server, too. So each request needs three
things:

* The ``Host`` header is one of this server's addresses. Another name that resolves to this address is refused.
* The cookie has the secret of a session. A browser gets one for the token in the printed address, or for a code
  that an operator shows. Other origins cannot use the cookie (SameSite=Strict).
* The ``Origin`` header is this server, if the request is not a GET, or opens a WebSocket.

A viewer may read, and may stop robots. An operator may do everything.
"""

from __future__ import annotations

import enum
import hashlib
import hmac
from collections.abc import Callable, Collection
from http.cookies import CookieError, SimpleCookie
from typing import NamedTuple

import msgspec

CODE_S = 120.0
"""How long a code is valid, in seconds."""
MOST_WRONG_CODES = 5
"""After so many wrong codes all codes end, and an operator has to show a new one."""
MOST_SESSIONS = 64
"""When there are more, the oldest session ends."""


class Role(enum.StrEnum):
    VIEWER = "viewer"
    OPERATOR = "operator"


class Session(msgspec.Struct, frozen=True):
    """A browser that may use the console.

    Attributes:
        id: Public name of the session.
        role: Its rights.
        device: The browser's own description, for people.
        since_s: When it was let in.
    """

    id: str
    role: Role
    device: str
    since_s: float


class Visit(NamedTuple):
    """The parts of a request that decide whether it is allowed. A missing header is an empty text."""

    method: str
    scheme: str
    host: str
    origin: str
    cookie: str
    is_websocket: bool = False


class Denied(NamedTuple):
    """A refusal: the HTTP status, and the text for the person."""

    status: int
    text: str


class _Code(NamedTuple):
    role: Role
    until_s: float


NO_SESSION = Denied(
    403, "This browser is not let in. Open the address that `strands-actors web` has printed, or ask for a code."
)


class Access:
    """The sessions of one server.

    Args:
        cookie: Name of the cookie. Two servers of one host need two names, since cookies ignore the port.
        new_secret: Returns a secret that cannot be guessed.
        new_code: Returns a code that a person can type.
    """

    def __init__(self, cookie: str, new_secret: Callable[[], str], new_code: Callable[[], str]) -> None:
        self.cookie = cookie
        self.token = new_secret()
        """A browser with this token becomes an operator."""
        self._new_secret = new_secret
        self._new_code = new_code
        self._hosts: frozenset[str] = frozenset()
        self._sessions: dict[bytes, Session] = {}
        self._codes: dict[str, _Code] = {}
        self._wrong_codes = 0

    def serve_at(self, hosts: Collection[str]) -> None:
        """Set the accepted values of the ``Host`` header, each ``name:port``."""
        self._hosts = frozenset(host.lower() for host in hosts)

    def refuse_sender(self, visit: Visit) -> Denied | None:
        """Return a refusal if the request comes from another page or for another host; None if it does not."""
        host = visit.host.lower()
        if host not in self._hosts:
            return Denied(421, "The host name is not one of this server.")
        changes = visit.method not in ("GET", "HEAD") or visit.is_websocket
        if changes and visit.origin.lower() != f"{visit.scheme}://{host}":
            return Denied(403, "The request comes from another page.")
        return None

    def session_of(self, visit: Visit) -> Session | Denied:
        """Return the session of a request, or why the request is refused."""
        if (denied := self.refuse_sender(visit)) is not None:
            return denied
        return self._sessions.get(_key(_cookie(visit.cookie, self.cookie)), NO_SESSION)

    # -- let browsers in

    def admit(self, token: str, device: str, now_s: float) -> str | Denied:
        """Return the secret of a new operator's session, for the token."""
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return Denied(403, "The token in the address is wrong. Copy the whole address.")
        return self._open(Role.OPERATOR, device, now_s)

    def offer(self, role: Role, now_s: float) -> str:
        """Return a code that lets one browser in."""
        self._forget_old(now_s)
        if not self._codes:
            self._wrong_codes = 0
        code = self._new_code()
        self._codes[code] = _Code(role, now_s + CODE_S)
        return code

    def redeem(self, code: str, device: str, now_s: float) -> str | Denied:
        """Return the secret of a new session, for a code. A code works once."""
        self._forget_old(now_s)
        entry = self._codes.pop("".join(code.split()), None)
        if entry is not None:
            return self._open(entry.role, device, now_s)
        self._wrong_codes += 1
        if self._wrong_codes >= MOST_WRONG_CODES:
            self._codes.clear()
        return Denied(403, "This code is not valid (any more). Ask for a new one.")

    def sessions(self) -> list[Session]:
        return list(self._sessions.values())

    def revoke(self, session_id: str) -> bool:
        """End a session. Return False if no session has this id."""
        keys = [key for key, session in self._sessions.items() if session.id == session_id]
        for key in keys:
            del self._sessions[key]
        return bool(keys)

    def holds(self, session: Session) -> bool:
        """Return True if the session has not ended."""
        return session in self._sessions.values()

    def _open(self, role: Role, device: str, now_s: float) -> str:
        secret = self._new_secret()
        while len(self._sessions) >= MOST_SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        key = _key(secret)
        self._sessions[key] = Session(key.hex()[:8], role, device, now_s)
        return secret

    def _forget_old(self, now_s: float) -> None:
        self._codes = {code: entry for code, entry in self._codes.items() if entry.until_s > now_s}


def _key(secret: str) -> bytes:
    """Return the key of a session. The time of a look-up does not depend on the secret."""
    return hashlib.sha256(secret.encode()).digest()


def _cookie(header: str, name: str) -> str:
    try:
        cookies = SimpleCookie(header)
    except CookieError:
        return ""
    return cookies[name].value if name in cookies else ""
