"""Parse the requests of a browser, and decide which are allowed. Pure.

Another web page that is open in the same browser can send requests to this port, too. So three things are checked:

* The address must have the token.
* The Host header must be one of this server's addresses. Another name that resolves to this address is refused.
* The Origin header of a WebSocket request must be the address of this page.
"""

from __future__ import annotations

import hmac
from collections.abc import Collection
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

MAX_HEAD = 8192
HEAD_END = b"\r\n\r\n"


class RequestHead(NamedTuple):
    """The head of an HTTP request: method, path, token and headers."""

    method: str
    path: str
    token: str
    headers: dict[str, str]

    @property
    def wants_websocket(self) -> bool:
        return self.headers.get("upgrade", "").lower() == "websocket"


def parse(head: bytes) -> RequestHead | None:
    """Parse the head of an HTTP request, from its bytes without ``HEAD_END``. Return None if it is not valid."""
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
        # A header that occurs twice makes the request invalid, because its meaning is ambiguous.
        if not colon or name.lower() in headers:
            return None
        headers[name.lower()] = value.strip()
    return RequestHead(method, parts.path, parse_qs(parts.query).get("token", [""])[-1], headers)


def refuse(request: RequestHead | None, token: str, hosts: Collection[str]) -> tuple[int, str] | None:
    """Return the HTTP status and text of a refusal; None if the request is allowed.

    Args:
        request: The request; None if it is not valid.
        token: The token of the page.
        hosts: Accepted values of the Host header, ``name:port``.
    """
    if request is None:
        return 400, "this is not a valid request"
    host = request.headers.get("host", "").lower()
    if host not in hosts:
        return 421, "the host name is not the one of this page"
    if not hmac.compare_digest(request.token.encode(), token.encode()):
        return 403, "the address needs its token"
    if request.method != "GET":
        return 405, "only the method GET is allowed"
    if request.path == "/" and not request.wants_websocket:
        return None
    if request.path != "/operate" or not request.wants_websocket:
        return 404, "there is no such page"
    if request.headers.get("origin", "").lower() != f"http://{host}":
        return 403, "the request comes from another page"
    return None


class Lateness:
    """Measure the delay of messages without a common clock.

    For each message, the difference between the time of receipt and the sender's time is computed. The smallest
    difference so far counts as no delay. The delay of a message is its difference minus the smallest one. Messages
    that were stuck in a network arrive late and all at once, and must not count as new.
    """

    def __init__(self) -> None:
        self._least_ns: int | None = None

    def of(self, sent_ms: float, received_ns: int) -> int:
        """Return the delay of a message in nanoseconds.

        Args:
            sent_ms: Time of sending in milliseconds, by the sender's clock.
            received_ns: Time of receipt in nanoseconds, by this computer's clock.
        """
        passed_ns = received_ns - round(sent_ms * 1e6)
        self._least_ns = passed_ns if self._least_ns is None else min(self._least_ns, passed_ns)
        return passed_ns - self._least_ns
