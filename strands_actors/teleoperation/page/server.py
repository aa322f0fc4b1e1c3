"""Serve the operator's web page, to one operator at a time. This runs in the process of the teleoperation."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import secrets
from collections.abc import Awaitable, Callable
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import trio
from wsproto import ConnectionType, WSConnection
from wsproto.events import AcceptConnection, CloseConnection, Message, Ping, Request, TextMessage
from wsproto.utilities import ProtocolError

from strands_actors.contract.stop_words import asks_for_stop
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.serving import GONE, Client, serve_clients
from strands_actors.supervisors.root.messages import Operate

from .requests import HEAD_END, MAX_HEAD, Lateness, parse, refuse

_log = logging.getLogger("strands_actors")

HEAD_S = 5.0
SEND_S = 1.0
STATUS_PERIOD_S = 0.1
SILENT_S = 2.0
"""A page without a message for so long counts as gone. Its connection could stay for ever, for example if a
phone sleeps or a network is lost."""
MAX_MESSAGE = 4096
STOPPED_SHOWN_S = 20.0
"""How long a page shows the result of its stop."""
STOP_REQUESTED = "asked, not confirmed yet"
MOST_STRANGERS = 16
"""Greatest number of clients that have not sent the token."""
LONGEST_MS = 1e12
"""Greatest time of a page's clock (about 30 years)."""
REASONS = {400: "Bad Request", 403: "Forbidden", 404: "Not Found", 405: "Method Not Allowed", 409: "Conflict",
           421: "Misdirected Request"}  # fmt: skip


class PageMessage(msgspec.Struct):
    """A message of the operator's page, which sends 30 messages per second.

    Attributes:
        held: True if the dead-man is held.
        at_ms: Time at which the page sent the message, by the browser's clock (ms).
        rates: Speed by axis, as a share (-1 to 1) of the highest speed at which an operator can move the axis.
        episode: The button of the recorder that was pressed; empty for no button.
        stop: True if the stop button was pressed.
    """

    held: bool
    at_ms: Annotated[float, msgspec.Meta(ge=0.0, le=LONGEST_MS)]
    rates: dict[str, float] = {}
    episode: Literal["", "start", "finish", "discard", "again"] = ""
    stop: bool = False


class _Operator:
    """The input from one connected web page: the delay of its messages, and the part of a message that has
    come."""

    def __init__(self) -> None:
        self.lateness = Lateness()
        self.text = ""
        self.has_let_go = False
        """True once the dead-man was released. A dead-man that is held from the first message on does not
        count."""


class Page:
    """The server of the operator's web page.

    Args:
        clock: This computer's clock, which gives the times of receipt.
        operate: Function that is called with the operator's input.
        press: Function that is called when a button of the recorder is pressed, with the time and the name of the
            button.
        stop: Function that stops the robot, and returns the result as text.
        status: Function that returns the data that the page shows.
        axes: Names of the axes that can be moved.
        tool: Names of the directions in which the tool can be moved, and of its turns.
        title: Title of the page.
    """

    def __init__(
        self,
        clock: Clock,
        operate: Callable[[Operate], None],
        press: Callable[[int, str], None],
        stop: Callable[[], Awaitable[str]],
        status: Callable[[], dict[str, Any]],
        axes: list[str],
        tool: list[str],
        title: str,
    ) -> None:
        self._clock = clock
        self._operate = operate
        self._press = press
        self._stop = stop
        self._stopping = False
        self._stopped = ""
        self._stopped_ns = 0
        self._status = status
        self._axes = axes
        self._tool = tool
        self._title = title
        self._token = secrets.token_urlsafe(24)
        self._hosts: frozenset[str] = frozenset()
        self._operated = False

    async def serve(self, host: str, port: int, publish_address: Callable[[str], None]) -> None:
        """Serve the operator's web page until cancelled. Raise ``OSError`` if the port cannot be opened.

        Args:
            host: Address to listen at.
            port: Port to listen at; 0 for a free one.
            publish_address: Function that is called with the address of the page, which contains the token.
        """
        (listener, *_) = await trio.open_tcp_listeners(port, host=host)
        number = listener.socket.getsockname()[1]
        names = {host, "localhost"} if host.startswith("127.") else {host}
        # Browsers send the host name in lower case.
        self._hosts = frozenset(f"{name.lower()}:{number}" for name in names)
        publish_address(f"http://{host}:{number}/?token={self._token}")
        # A stop runs in this nursery. So it continues even if the page that requested it disconnects.
        async with trio.open_nursery() as self._stops:
            await serve_clients(self._answer, listener, MOST_STRANGERS, SEND_S)

    async def _answer(self, client: Client) -> None:
        data = b""
        with trio.fail_after(HEAD_S):
            while HEAD_END not in data:
                more = await client.receive(MAX_HEAD)
                data += more
                if not more or len(data) > MAX_HEAD:
                    return
        request = parse(data.partition(HEAD_END)[0])
        refusal = refuse(request, self._token, self._hosts)
        if refusal is None:
            client.admit()
        if refusal is None and request is not None and request.wants_websocket:
            if not self._operated:
                self._operated = True
                try:
                    await self._converse(client, data)
                finally:
                    self._operated = False
                    self._operate(Operate(self._clock.now_ns(), False))
                return
            refusal = 409, "another browser operates the robot. Close its page first"
        if refusal is not None:
            await _respond(client, refusal[0], "text/plain", refusal[1].encode())
            return
        nonce = secrets.token_urlsafe(12)
        page = resources.files(__package__).joinpath("page.html").read_text("utf-8")
        page_data = json.dumps({"axes": self._axes, "tool": self._tool, "title": self._title}).replace(
            "<", "\\u003c"
        )
        body = page.replace("NONCE", nonce).replace("/*TOLD*/null", page_data).encode()
        policy = (
            f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'; "
            "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )
        await _respond(client, 200, "text/html; charset=utf-8", body, policy)

    async def _converse(self, client: Client, data: bytes) -> None:
        """Exchange messages with one page until it disconnects. Afterwards the caller of this method releases the
        dead-man.
        """
        end = WSConnection(ConnectionType.SERVER)
        operator = _Operator()
        async with trio.open_nursery() as nursery:
            try:
                while True:
                    end.receive_data(data or None)
                    for event in end.events():
                        if isinstance(event, Request):
                            await client.send(end.send(AcceptConnection()))
                            nursery.start_soon(self._send_status, client, end, nursery.cancel_scope)
                        elif isinstance(event, Ping):
                            await client.send(end.send(event.response()))
                        elif isinstance(event, Message):
                            if not isinstance(event, TextMessage):
                                return
                            operator.text += event.data  # the network may have split the message
                            if len(operator.text) > MAX_MESSAGE:
                                return
                            if event.message_finished:
                                text, operator.text = operator.text, ""
                                self._take(text, operator)
                        elif isinstance(event, CloseConnection):
                            await client.send(end.send(event.response()))
                            return
                    data = b""
                    with trio.move_on_after(SILENT_S):
                        data = await client.receive(MAX_MESSAGE)
                    if not data:
                        return
            except (ProtocolError, msgspec.MsgspecError, RecursionError, UnicodeError):
                return  # This package's page never sends such data, so disconnect.
            finally:
                nursery.cancel_scope.cancel()

    def _take(self, text: str, operator: _Operator) -> None:
        now_ns = self._clock.now_ns()
        try:
            message = msgspec.json.decode(text, type=PageMessage)
        except (msgspec.MsgspecError, RecursionError):
            if asks_for_stop(text):
                self._begin_stop()
            raise
        operator.has_let_go = operator.has_let_go or not message.held
        held = message.held and operator.has_let_go
        t_ns = now_ns - operator.lateness.of(message.at_ms, now_ns)
        self._operate(Operate(t_ns, held, message.rates))
        if message.episode:
            self._press(t_ns, message.episode)
        if message.stop:
            self._begin_stop()

    def _begin_stop(self) -> None:
        if not self._stopping:
            self._stopping, self._stopped = True, STOP_REQUESTED
            self._stops.start_soon(self._stop_robot)

    async def _stop_robot(self) -> None:
        try:
            self._stopped = await self._stop()
        except Exception as failure:  # keep the server running, so that the operator can press stop again
            _log.exception("the page's stop failed")
            self._stopped = f"NOT CONFIRMED: {failure!r}. Cut its power if it still moves"
        self._stopping = False
        self._stopped_ns = self._clock.now_ns()

    def _shown(self) -> dict[str, Any]:
        is_old = not self._stopping and self._clock.now_ns() - self._stopped_ns > STOPPED_SHOWN_S * NS
        return {**self._status(), "stopped": "" if is_old else self._stopped}

    async def _send_status(self, client: Client, end: WSConnection, scope: trio.CancelScope) -> None:
        """Send the data that the page shows, again and again. A page that reads nothing is disconnected."""
        try:
            while True:
                await client.send(end.send(TextMessage(json.dumps(self._shown()))))
                await trio.sleep(STATUS_PERIOD_S)
        except (*GONE, ProtocolError):
            scope.cancel()


async def _respond(client: Client, code: int, content_type: str, body: bytes, policy: str = "") -> None:
    reason = REASONS.get(code, "OK")
    rows = [
        f"HTTP/1.1 {code} {reason}",
        f"Content-Type: {content_type}",
        f"Content-Length: {len(body)}",
        "Cache-Control: no-store",
        "Referrer-Policy: no-referrer",
        "X-Content-Type-Options: nosniff",
        "Connection: close",
        *([f"Content-Security-Policy: {policy}"] if policy else []),
    ]
    await client.send("\r\n".join(rows).encode() + HEAD_END + body)


def write_address(path: Path, text: str) -> None:
    """Write the page's address to a file that only the user can read. Other programs never see a part of the
    address.
    """
    new = path.with_suffix(f".{os.getpid()}.new")
    with contextlib.suppress(FileNotFoundError):
        new.unlink()
    with open(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(text)
    os.replace(new, path)
