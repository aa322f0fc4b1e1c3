"""Let only allowed requests reach an application, and give each answer its headers."""

from __future__ import annotations

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .access import Access, Session, Visit

OPEN_PATHS = ("/", "/pair")
"""Pages that check the visitor themselves: where a browser without a session is let in."""
REFUSED_SOCKET = 1008
_HEADERS = {
    "Cache-Control": "no-store",
    # With "no-referrer" a browser sends ``Origin: null`` with a form, and the e-stop would be refused.
    "Referrer-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-site",
    # The browser then gives this origin a process of its own, which another page cannot block.
    "Origin-Agent-Cluster": "?1",
}


class Guard:
    """Stands before an application.

    ``scope["state"]["session"]`` is the visitor's session, and missing on the pages of ``OPEN_PATHS``.

    Args:
        app: The application.
        access: The sessions.
        policy: The Content-Security-Policy of each answer.
    """

    def __init__(self, app: ASGIApp, access: Access, policy: str) -> None:
        self._app = app
        self._access = access
        self._headers = {**_HEADERS, "Content-Security-Policy": policy}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        visit = visit_of(scope)

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in self._headers.items():
                    headers.setdefault(name, value)
            await send(message)

        if scope["path"] in OPEN_PATHS:
            denied = self._access.refuse_sender(visit)
        elif isinstance(session := self._access.session_of(visit), Session):
            denied = None
            scope.setdefault("state", {})["session"] = session
        else:
            denied = session
        if denied is None:
            await self._app(scope, receive, send_guarded)
        elif visit.is_websocket:
            await receive()
            await send({"type": "websocket.close", "code": REFUSED_SOCKET, "reason": denied.text})
        else:
            await PlainTextResponse(denied.text, denied.status)(scope, receive, send_guarded)


def visit_of(scope: Scope) -> Visit:
    """Return what decides about a request."""
    headers = Headers(scope=scope)
    is_websocket = scope["type"] == "websocket"
    secure = scope["scheme"] in ("https", "wss")
    return Visit(
        "GET" if is_websocket else scope["method"],
        "https" if secure else "http",
        headers.get("host", ""),
        headers.get("origin", ""),
        headers.get("cookie", ""),
        is_websocket,
    )
