"""Bring a Reachy Mini to a safe state. The process that drives the robot and the supervising process (root) use
this code.

The first messages need no answer. They are sent at once on every open connection, even if unreadable bytes have
been received there. Without an open connection they are sent together with the request that opens a new
WebSocket. Only a WebSocket can end the move of any client. At the same time HTTP requests remove the torque,
end face tracking, and end the move if its id is known.

A stop counts as confirmed only after these answers:

* A ping sent after the messages is answered, so the daemon has read them. This is required because no list contains
  the moves that were begun over a WebSocket.
* Over HTTP: face tracking is off, the second of two queries lists no running move, and the motors are in the
  required mode.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import KeptSession
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.kit.velocity_base import nothing_pending
from strands_actors.drivers.common.ports.http_port import HttpPort
from strands_actors.drivers.common.ports.tcp_port import NobodyListens
from strands_actors.drivers.common.ports.websocket import WebSocket, begin_websocket, open_websocket
from strands_actors.kernel.clock import Clock

from . import protocol as p
from .config import ReachyConfig

STOP_S = 1.7
"""How long a stop is repeated. It is less than ``Timing.safe_s``, and than the time that remains of it after a
link was reached."""

CONNECT_S = 0.4
"""Timeout for opening a WebSocket."""

REPEAT_S = 0.03
"""Period in which the frames are sent again until the upgrade is answered. uvicorn, in the daemon, drops data
that it reads together with the upgrade."""

ANSWER_S = 0.3
"""Timeout for the answer to one request."""

AGAIN_S = 0.05
"""Pause before an attempt is repeated."""


def frames(safe_state: SafeState) -> tuple[str, ...]:
    """Return the WebSocket messages that bring the robot to a safe state, in the order of sending."""
    ends = (p.STOP_MOVE, p.TRACKING_STOP, p.WOBBLING_STOP)
    return (p.MOTORS_OFF, *ends) if safe_state == SafeState.LIMP else ends


def requests(safe_state: SafeState, running: str = "") -> tuple[tuple[str, bytes], ...]:
    """Return the HTTP requests that bring the robot to a safe state, as target and body.

    Args:
        safe_state: The safe state.
        running: The id of the running move if it is known. HTTP can end no other move.
    """
    ends = [(p.STOP, p.encode_uuid(running))] if running else []
    ends.append((p.TRACKING_OFF, b""))
    return ((f"{p.SET_MODE}disabled", b""), *ends) if safe_state == SafeState.LIMP else tuple(ends)


def send_at_once(
    safe_state: SafeState, sockets: Sequence[WebSocket | None], ports: Sequence[HttpPort | None], running: str = ""
) -> bool:
    """Send the messages of a stop on each connection that can be written, even if unreadable bytes were
    received there. Return True if any message was sent. Never waits, never raises."""
    sent = False
    for socket in sockets:
        if socket is not None:
            # Skip a connection that is closed.
            with contextlib.suppress(WireDown):
                socket.send_stop(*frames(safe_state))
                sent = True
    for port in ports:
        if port is not None:
            with contextlib.suppress(WireDown):
                for target, body in requests(safe_state, running):
                    port.send_stop("POST", target, body)
                    sent = True
    return sent


class Stopper:
    """Stop the robot of one daemon.

    Args:
        host: The daemon's host.
        number: The daemon's port.
        socket: An open connection to ``/ws/sdk``, or None. It stays open.
        has_receiver: Returns True if another task receives on ``socket``.
        running: Returns the id of our running move; empty without one.

    Attributes:
        detail: Why the robot is not confirmed as safe; empty if it is.
    """

    def __init__(
        self,
        host: str,
        number: int,
        socket: WebSocket | None = None,
        has_receiver: Callable[[], bool] = lambda: False,
        running: Callable[[], str] = lambda: "",
    ) -> None:
        self._address = host, number
        self._socket = socket
        self._has_receiver = has_receiver
        self._running_move = running
        self._own: WebSocket | None = None
        # Number of the ping that followed the last messages; 0 before the first ping.
        self._pinged = 0
        self._port = HttpPort(host, number)
        self.written = self.acknowledged = False
        # True if the last attempt to connect was refused.
        self._is_refused = False
        self.detail = ""

    async def run(
        self, safe_state: SafeState, within_s: float, pending: Callable[[], bool] = nothing_pending
    ) -> str:
        """Bring the robot to ``safe_state``. Never raises.

        If a connection is open, the first message is sent before anything is waited for.

        Args:
            safe_state: The safe state.
            within_s: How long to repeat the requests that are not confirmed.
            pending: Returns True if an earlier command has no answer yet. That command may still take effect.

        Returns:
            Why the safe state is not confirmed; empty if it is.
        """
        self.detail = f"not confirmed: {self._port.name} is silent"
        self.written = send_at_once(safe_state, [self._socket], []) or self.written
        with trio.move_on_after(within_s):
            while True:
                # Read ``pending`` first. A command that is answered during ``_look`` may have taken effect after
                # it.
                unanswered = pending()
                try:
                    async with trio.open_nursery() as nursery:
                        nursery.start_soon(self._order, safe_state)
                        nursery.start_soon(self._order_by_http, safe_state)
                    detail = await self._look(safe_state)
                    if not detail and unanswered:
                        detail = "not confirmed: an earlier command has no answer yet, so it may still take effect"
                    self.detail = detail
                    if not detail:
                        return ""
                except MalformedFrame as malformed:
                    self.detail, self._is_refused = f"not confirmed: {malformed}", False
                except WireDown as down:
                    self.detail = f"not confirmed: {down}" if self.written else str(down)
                    self._is_refused = isinstance(down, NobodyListens)
                await trio.sleep(AGAIN_S)
        return self.detail

    @property
    def has_no_daemon(self) -> bool:
        """Return True if the connection was refused, so no daemon runs at that address. A daemon that does not
        answer may still be the robot's."""
        return not self.written and self._is_refused

    def close(self) -> None:
        # Close without dropping sent bytes.
        self._port.close_in_order()
        if self._own is not None:
            self._own.close_in_order()

    async def _order(self, safe_state: SafeState) -> None:
        """Send the messages of the stop on the WebSocket, then a ping. Never raises. ``_look`` finds out later
        if they were not received."""
        self._pinged = 0
        with contextlib.suppress(WireDown):
            if self._socket is None or not self._socket.is_open:
                self._socket = await self._begin(safe_state)
            self._socket.send_stop(*frames(safe_state))
            self.written = True
            self._pinged = self._socket.ping()

    async def _begin(self, safe_state: SafeState) -> WebSocket:
        """Open a WebSocket for the stop, and return it when the daemon has accepted it. The messages of the
        stop are sent with the opening request and repeated until then. Raise ``WireDown``."""
        stop = frames(safe_state)
        begun = await begin_websocket(*self._address, p.SDK, within_s=CONNECT_S, stop=stop)
        self.written = True
        before, self._own = self._own, begun
        if before is not None:
            before.close_in_order()
        while begun.is_pending and not await begun.accepted(REPEAT_S):
            begun.send_stop(*stop)
        return begun

    async def _order_by_http(self, safe_state: SafeState) -> None:
        """Send the HTTP requests of the stop. Never raises."""
        with contextlib.suppress(WireDown):
            await self._port.ready()
            self.written = send_at_once(safe_state, [], [self._port], self._running_move()) or self.written

    async def _look(self, safe_state: SafeState) -> str:
        """End the listed moves and face tracking, and read the motors' mode. Return why the robot is not
        confirmed as safe; empty if it is safe."""
        for uuid in await self._running():
            await self._port.ask("POST", p.STOP, p.encode_uuid(uuid), within_s=ANSWER_S)
        self.acknowledged = True
        tracks = await self._end_tracking()
        await self._read_by_daemon()
        if running := await self._running():
            return f"not confirmed: {len(running)} moves are running"
        if safe_state == SafeState.LIMP:
            answer = await self._port.ask("GET", p.MOTORS, within_s=ANSWER_S)
            mode = p.MODES[p.decode_mode(answer.body)]
            if mode != "disabled":
                return f"not confirmed: the motors are {mode}"
        return tracks

    async def _end_tracking(self) -> str:
        """End face tracking. Return why it may still run; empty if it is off. A daemon that lacks this path has
        no face tracking."""
        answer = await self._port.ask("POST", p.TRACKING_OFF, within_s=ANSWER_S)
        if answer.status == p.NOT_FOUND:
            return ""
        if answer.status == p.OK and p.decode_object(answer.body).get("enabled") is False:
            return ""
        return (
            f"not confirmed: {p.TRACKING_OFF} was answered with status {answer.status}: it may still track a face"
        )

    async def _read_by_daemon(self) -> None:
        """Wait until the daemon has read the messages of the stop. Answers to earlier queries do not show the
        effect of the stop. Raise ``WireDown``."""
        socket, error = self._socket, ""
        if socket is None or not self._pinged:
            raise WireDown(
                f"{self._port.name}: {p.SDK}: no WebSocket is open, and only that ends a move. Check the daemon"
            )
        async with trio.open_nursery() as nursery:
            if socket is self._own or not self._has_receiver():
                nursery.start_soon(_drain, socket)
            try:
                await socket.ponged(self._pinged, ANSWER_S)
            except WireDown as down:
                error = str(down)
            nursery.cancel_scope.cancel()
        if error:
            raise WireDown(error)

    async def _running(self) -> Sequence[str]:
        answer = await self._port.ask("GET", p.RUNNING, within_s=ANSWER_S)
        if answer.status != p.OK:
            raise WireDown(
                f"{self._port.name}: {p.RUNNING} was answered with status {answer.status}. Check the daemon"
            )
        return p.decode_running(answer.body)


async def _drain(socket: WebSocket) -> None:
    """Receive and drop messages, so that the answer to a ping is noticed."""
    with contextlib.suppress(WireDown):
        while True:
            await socket.receive()


class ReachyStopChannel(KeptSession[ReachyConfig, WebSocket]):
    """Stop a Reachy Mini from the supervising process (root). The root keeps a WebSocket open to the daemon that
    the wire process found, and opens others when needed. ``descriptors`` contains the published address
    (``config.publish_address``), or is empty."""

    SERVED_FIRST: ClassVar[bool] = False

    def __init__(self, config: ReachyConfig, descriptors: Sequence[int], clock: Clock) -> None:
        super().__init__(config.with_published_address(descriptors[0]) if descriptors else config, (), clock)

    @property
    def hosts(self) -> Sequence[str]:
        return tuple(host for host, _ in self.config.addresses())

    async def connect(self) -> WebSocket:
        try:
            (host, number), *alternatives = self.config.addresses()
        except ValueError as error:
            raise WireDown(str(error)) from None
        if alternatives:
            raise WireDown("the daemon has not been found yet")
        return await open_websocket(host, number, p.SDK, within_s=CONNECT_S)

    async def keep_up(self, session: WebSocket) -> None:
        while True:
            # Read and drop the states. Otherwise the daemon's send buffer would fill up.
            await session.receive()

    async def make_safe_by(self, session: WebSocket | None, safe_state: SafeState) -> tuple[MotorReport, ...]:
        return await stop_all_addresses(self.config, safe_state, session)


async def stop_all_addresses(
    config: ReachyConfig, safe_state: SafeState, session: WebSocket | None = None
) -> tuple[MotorReport, ...]:
    """Stop the robot at each possible address. Never raises.

    An address that refuses the connection has no daemon. Every other address must confirm the stop, because it
    may be the robot's.

    Args:
        config: The robot's settings.
        safe_state: The safe state.
        session: An open connection, if there is only one address.
    """
    try:
        stoppers = [Stopper(host, number, session) for host, number in config.addresses()]
    except ValueError as error:
        return Outcome(False, False, str(error)).reports(config.axes, config.ids)

    async def stop(stopper: Stopper, scope: trio.CancelScope) -> None:
        # One daemon has confirmed the stop. The other addresses get as much time as one connection takes.
        if not await stopper.run(safe_state, STOP_S):
            scope.deadline = min(scope.deadline, trio.current_time() + CONNECT_S)

    try:
        async with trio.open_nursery() as nursery:
            for stopper in stoppers:
                nursery.start_soon(stop, stopper, nursery.cancel_scope)
    finally:
        for stopper in stoppers:
            stopper.close()
    candidates = [stopper for stopper in stoppers if not stopper.has_no_daemon] or stoppers
    outcome = Outcome(
        written=any(stopper.written for stopper in candidates),
        acknowledged=all(stopper.acknowledged for stopper in candidates),
        detail=next((stopper.detail for stopper in candidates if stopper.detail), ""),
    )
    return outcome.reports(config.axes, config.ids)
