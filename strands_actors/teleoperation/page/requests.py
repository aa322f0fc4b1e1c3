"""Parse the requests of a browser, and decide which are allowed. Pure.

A foreign page that is open in the same browser can reach this port, too. So three things are checked:

* The address must have the token.
* The host must be the served one. A foreign name that resolves to this address is another host.
* A WebSocket must come from this very page (its origin).
"""

from __future__ import annotations

import hmac
from collections.abc import Collection
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

MAX_HEAD = 8192
HEAD_END = b"\r\n\r\n"


class Asked(NamedTuple):
    """The head of a request."""

    method: str
    path: str
    token: str
    headers: dict[str, str]

    @property
    def wants_websocket(self) -> bool:
        return self.headers.get("upgrade", "").lower() == "websocket"


def parse(head: bytes) -> Asked | None:
    """Return the head of a request, from its bytes without ``HEAD_END``; None if it is not valid."""
    try:
        line, *rows = head.decode("latin-1").split("\r\n")
        method, target, version = line.split(" ")
        parts = urlsplit(target)
    except ValueError:
        return None
    if not version.startswith("HTTP/1."):
        return None
    headers: dict[str, str] = {}
    for row in rows:
        name, colon, value = row.partition(":")
        # A repeated header is refused, since its meaning is ambiguous.
        if not colon or name.lower() in headers:
            return None
        headers[name.lower()] = value.strip()
    return Asked(method, parts.path, parse_qs(parts.query).get("token", [""])[-1], headers)


def refuse(asked: Asked | None, token: str, hosts: Collection[str]) -> tuple[int, str] | None:
    """Return the HTTP status and text of a refusal; None if the request is allowed.

    Args:
        asked: The request; None if it is not valid.
        token: The token of the page.
        hosts: Accepted values of the Host header, ``name:port``.
    """
    if asked is None:
        return 400, "no request"
    host = asked.headers.get("host", "").lower()
    if host not in hosts:
        return 421, "another host"
    if not hmac.compare_digest(asked.token.encode(), token.encode()):
        return 403, "the address needs its token"
    if asked.method != "GET":
        return 405, "only GET"
    if asked.path == "/" and not asked.wants_websocket:
        return None
    if asked.path != "/operate" or not asked.wants_websocket:
        return 404, "nothing there"
    if asked.headers.get("origin", "").lower() != f"http://{host}":
        return 403, "another origin"
    return None


class Lateness:
    """Measure the delay of messages without a common clock.

    The message with the smallest difference of receive time and sender's time counts as the fastest so far.
    The delay of a message is its difference minus that. Messages that were stuck in a network arrive late
    and all at once, and must not count as new.
    """

    def __init__(self) -> None:
        self._least_ns: int | None = None

    def of(self, sent_ms: float, received_ns: int) -> int:
        """Return the delay of a message in nanoseconds.

        Args:
            sent_ms: Time of sending, by the sender's clock.
            received_ns: Time of receipt, by our clock.
        """
        passed_ns = received_ns - round(sent_ms * 1e6)
        self._least_ns = passed_ns if self._least_ns is None else min(self._least_ns, passed_ns)
        return passed_ns - self._least_ns
