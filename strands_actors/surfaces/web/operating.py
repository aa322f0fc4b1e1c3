"""The page of one operator: it moves a robot, stops it, and has the recorder's buttons.

It is served by the process that needs it: that of a teleoperation, or a recorder. The console has the same buttons
for all robots.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import math
import secrets
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, Literal

import msgspec
import trio
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from strands_actors.caller.processes.run_directory import data_dir
from strands_actors.contract.stop_words import asks_for_stop
from strands_actors.kernel.clock import NS, Clock
from strands_actors.supervisors.root.messages import Operate
from strands_actors.teleoperation.lateness import Lateness

from .access import Access, Denied
from .certificates import certificate_for
from .doors import LOCAL_NAMES, open_door, serve_doors
from .guard import Guard, visit_of
from .pages import as_attribute, as_denied, device_of, let_in, page_of, serve_file
from .sockets import BAD_MESSAGE, DISCONNECTED, ENDED, LONGEST_MS, send

_log = logging.getLogger("strands_actors")

SEND_S = 1.0
"""A page that has not read a message after this time is disconnected."""
STATUS_PERIOD_S = 0.1
SILENT_S = 2.0
"""A page without a message for so long counts as gone. Its connection could stay for ever, for example if a
phone sleeps or a network is lost."""
STOPPED_SHOWN_S = 20.0
"""How long a page shows the result of its stop."""
STOP_REQUESTED = "asked, not confirmed yet"
GONE = "gone"
TAKEN = "another browser operates the robot. Close its page first"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)


def is_local(host: str) -> bool:
    """Return True if only this computer can reach this address."""
    return host in LOCAL_NAMES or host.startswith("127.")


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


class OperatorPage:
    """The server of the operator's page. Only one open page at a time has the operator's seat.

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
        self._stopped_ns = -math.inf
        self._status = status
        self._facts = {"axes": axes, "tool": tool, "title": title}
        self._is_taken = False

    async def serve(self, host: str, port: int, publish_address: Callable[[str], None]) -> None:
        """Serve the page until cancelled. Other devices get it encrypted only.

        Args:
            host: Address to listen at.
            port: Port to listen at; 0 for a free one.
            publish_address: Function that is called with the address of the page, which contains the token.

        Raises:
            CannotListen: The port cannot be opened.
        """
        host = host.lower()
        names: tuple[str, ...] = (host,)
        certificate = None
        if is_local(host):
            names = tuple(dict.fromkeys((host, *LOCAL_NAMES)))
        else:
            certificate = await trio.to_thread.run_sync(certificate_for, host, data_dir() / "console")
        with contextlib.ExitStack() as stack:
            door = open_door(stack, host, port, names, certificate)
            access = Access(f"operate_{door.port}", functools.partial(secrets.token_urlsafe, 32), str)
            access.serve_at(door.hosts)
            app = Starlette(
                routes=[
                    Route("/", functools.partial(self._home, access)),
                    Route("/page/{file}", serve_file),
                    WebSocketRoute("/operate", self._converse),
                ]
            )
            # A stop runs in this nursery. So it continues even if the page that requested it disconnects.
            async with trio.open_nursery() as self._stops:
                publish_address(f"{door.origins[0]}/?token={access.token}")
                await serve_doors(Guard(app, access, POLICY), [door], trio.sleep_forever)

    async def _home(self, access: Access, request: Request) -> Response:
        token = request.query_params.get("token")
        if token is not None:
            secret = access.admit(token, device_of(request), self._clock.now_ns() / NS)
            return as_denied(secret) if isinstance(secret, Denied) else let_in(access, request, secret)
        session = access.session_of(visit_of(request.scope))
        if isinstance(session, Denied):
            return as_denied(session)
        return page_of("operate.html", facts=as_attribute(self._facts))

    async def _converse(self, socket: WebSocket) -> None:
        """Exchange messages with one page until it disconnects. Then the dead-man counts as released."""
        await socket.accept()
        if self._is_taken:
            # Hypercorn sends no reason with the end of a connection.
            await socket.send_text(msgspec.json.encode({"state": GONE, "why": TAKEN, "stopped": ""}).decode())
            await socket.close(ENDED)
            return
        self._is_taken = True
        try:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self._send_status, socket, nursery.cancel_scope)
                with contextlib.suppress(*DISCONNECTED):
                    await self._listen(socket)
                nursery.cancel_scope.cancel()
        finally:
            self._is_taken = False
            self._operate(Operate(self._clock.now_ns(), False))

    async def _listen(self, socket: WebSocket) -> None:
        lateness, has_let_go = Lateness(), False
        while True:
            text = ""
            with trio.move_on_after(SILENT_S):
                message = await socket.receive()
                if message["type"] == "websocket.disconnect":
                    return
                text = message.get("text") or ""
            if not text:
                await socket.close(ENDED)
                return
            now_ns = self._clock.now_ns()
            try:
                order = msgspec.json.decode(text, type=PageMessage)
            except (msgspec.MsgspecError, RecursionError, UnicodeError):
                if asks_for_stop(text):
                    self._begin_stop()
                await socket.close(BAD_MESSAGE)
                return
            # A dead-man that is held from the first message on does not count.
            has_let_go = has_let_go or not order.held
            t_ns = now_ns - lateness.of(order.at_ms, now_ns)
            self._operate(Operate(t_ns, order.held and has_let_go, order.rates))
            if order.episode:
                self._press(t_ns, order.episode)
            if order.stop:
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

    async def _send_status(self, socket: WebSocket, scope: trio.CancelScope) -> None:
        """Send the data that the page shows, again and again. A page that reads nothing is disconnected."""
        with contextlib.suppress(*DISCONNECTED):
            while True:
                await send(socket, msgspec.json.encode(self._shown()).decode(), SEND_S)
                await trio.sleep(STATUS_PERIOD_S)
        scope.cancel()
