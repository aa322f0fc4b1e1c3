"""What a browser asks, and whether it may. Pure.

A page of somebody else's, open in the same browser, can reach this port, too: so the address has a
token, the host has to be the one that is served (a name that was pointed here is another), and a
WebSocket has to come from this very page.
"""

from __future__ import annotations

import hmac
from collections.abc import Collection
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

MAX_HEAD = 8192
HEAD_END = b"\r\n\r\n"


class Asked(NamedTuple):
    method: str
    path: str
    token: str
    headers: dict[str, str]

    @property
    def wants_websocket(self) -> bool:
        return self.headers.get("upgrade", "").lower() == "websocket"


def parse(head: bytes) -> Asked | None:
    """The head of a request, without its end; None: it is none."""
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
        if not colon or name.lower() in headers:  # one that stands twice is two opinions
            return None
        headers[name.lower()] = value.strip()
    return Asked(method, parts.path, parse_qs(parts.query).get("token", [""])[-1], headers)


def refuse(asked: Asked | None, token: str, hosts: Collection[str]) -> tuple[int, str] | None:
    """Why not, as HTTP says it; None: it may. ``hosts``: as the page's own address names them."""
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
    """How late a message is, without a common clock: later than the quickest so far, by so much
    more than the sender's own clock has passed. What was stuck in a network comes late, all at
    once, and must not be taken for the present."""

    def __init__(self) -> None:
        self._least_ns: int | None = None

    def of(self, sent_ms: float, received_ns: int) -> int:
        """Nanoseconds."""
        passed_ns = received_ns - round(sent_ms * 1e6)
        self._least_ns = passed_ns if self._least_ns is None else min(self._least_ns, passed_ns)
        return passed_ns - self._least_ns
