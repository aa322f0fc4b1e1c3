"""How a Reachy Mini is brought to a safe state, by the wire and by the root's stop channel alike.

The first frame goes over the daemon's WebSocket, on a connection that is open or made for it: only
there a move can be ended whoever began it. A ping behind the frames is answered once they were
read: no list has the moves that were begun over a WebSocket. What confirms the rest is asked over
HTTP: face tracking is off, no move is listed any more, at two looks, and the motors are in the mode
that was ordered.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.drivers.common.http_port import HttpPort
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.outcome import Outcome
from strands_actors.drivers.common.tcp_port import NobodyListens
from strands_actors.drivers.common.velocity_base import nothing_pending
from strands_actors.drivers.common.websocket import WebSocket, open_websocket
from strands_actors.kernel.clock import Clock

from . import protocol as p
from .config import ReachyConfig

STOP_S = 1.7
"""How long a stop is repeated: less than ``Timing.safe_s``, and than what is left of it when a link
is reached."""

CONNECT_S = 0.4
"""Within which a WebSocket must be there."""

ANSWER_S = 0.3
"""How long one question waits for its answer."""

AGAIN_S = 0.05
"""Pause before what is not confirmed is done again."""


def frames(safe_state: SafeState) -> tuple[str, ...]:
    """Return what brings the robot to a safe state, in the order in which it is sent."""
    ends = (p.STOP_MOVE, p.TRACKING_STOP, p.WOBBLING_STOP)
    return (p.MOTORS_OFF, *ends) if safe_state == SafeState.LIMP else ends


class Stopper:
    """For one daemon. ``socket``: an open connection to ``/ws/sdk``, if there is one; it stays
    open. ``heard``: whether another task receives on it. ``detail``: why it is not known to be
    safe; empty: it is."""

    def __init__(
        self, host: str, number: int, socket: WebSocket | None = None, heard: Callable[[], bool] = lambda: False
    ) -> None:
        self._where = host, number
        self._socket = socket
        self._heard = heard
        self._own: WebSocket | None = None
        self._pinged = 0  # behind the frames that were sent last
        self._port = HttpPort(host, number)
        self.written = self.acknowledged = False
        self._is_refused = False  # the newest attempt
        self.detail = f"not confirmed: {self._port.name} is silent"

    async def run(
        self, safe_state: SafeState, within_s: float, pending: Callable[[], bool] = nothing_pending
    ) -> str:
        """Bring the robot to ``safe_state``; return why that is not confirmed, empty: it is. Never
        raises. Where a WebSocket is open the first frame leaves before the first wait. ``pending``:
        whether an earlier command has not been answered, which may be carried out later."""
        with trio.move_on_after(within_s):
            while True:
                owed = pending()  # what is answered while we look may have been carried out after that
                try:
                    await self._order(safe_state)
                    detail = await self._look(safe_state)
                    if not detail and owed:
                        detail = "not confirmed: an earlier command has not been answered"
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
    def nobody_there(self) -> bool:
        """Return whether the connection is refused: no daemon runs there. One that does not answer
        may be the robot's."""
        return not self.written and self._is_refused

    def close(self) -> None:
        self._port.close()
        if self._own is not None:
            self._own.close_in_order()  # what was sent still arrives

    async def _order(self, safe_state: SafeState) -> None:
        if self._socket is None or not self._socket.is_open:
            self._socket = self._own = await open_websocket(*self._where, p.SDK, within_s=CONNECT_S)
        for frame in frames(safe_state):
            self._socket.send(frame)
        self.written = True
        self._pinged = self._socket.ping()

    async def _look(self, safe_state: SafeState) -> str:
        """End the moves that are listed, and face tracking; return why the robot is not known to be
        safe."""
        for uuid in await self._running():
            await self._port.ask("POST", p.STOP, p.encode_uuid(uuid), within_s=ANSWER_S)
        self.acknowledged = True
        tracks = await self._end_tracking()
        await self._read_by_daemon()
        if left := await self._running():
            return f"not confirmed: {len(left)} moves are running"
        if safe_state == SafeState.LIMP:
            answer = await self._port.ask("GET", p.MOTORS, within_s=ANSWER_S)
            mode = p.MODES[p.decode_mode(answer.body)]
            if mode != "disabled":
                return f"not confirmed: the motors are {mode}"
        return tracks

    async def _end_tracking(self) -> str:
        """Return why face tracking may go on. A daemon without that path has none."""
        answer = await self._port.ask("POST", p.TRACKING_OFF, within_s=ANSWER_S)
        if answer.status == p.NOT_FOUND:
            return ""
        if answer.status == p.OK and p.decode_object(answer.body).get("enabled") is False:
            return ""
        return f"not confirmed: {p.TRACKING_OFF} is answered with status {answer.status}: it may track a face"

    async def _read_by_daemon(self) -> None:
        """Wait until it has read the frames: what is asked before that says nothing of what they
        end. Raise ``WireDown``."""
        socket, why = self._socket, ""
        if socket is None:
            return
        async with trio.open_nursery() as nursery:
            if socket is self._own or not self._heard():
                nursery.start_soon(_drain, socket)
            try:
                await socket.ponged(self._pinged, ANSWER_S)
            except WireDown as down:
                why = str(down)
            nursery.cancel_scope.cancel()
        if why:
            raise WireDown(why)

    async def _running(self) -> Sequence[str]:
        answer = await self._port.ask("GET", p.RUNNING, within_s=ANSWER_S)
        if answer.status != p.OK:
            raise WireDown(
                f"{self._port.name}: {p.RUNNING} is answered with status {answer.status}. Check the daemon"
            )
        return p.decode_running(answer.body)


async def _drain(socket: WebSocket) -> None:
    """Receive, so that a pong is heard."""
    with contextlib.suppress(WireDown):
        while True:
            await socket.receive()


class ReachyStopChannel(StopChannel):
    """The root's way to the robot: connections made when they are needed. ``descriptors``: the place
    where the wire found it (``config.tell_place``), or none."""

    def __init__(self, config: ReachyConfig, descriptors: Sequence[int], clock: Clock) -> None:
        self._config = config.at_told(descriptors[0]) if descriptors else config

    @property
    def hosts(self) -> Sequence[str]:
        return tuple(host for host, _ in self._config.addresses())

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        return await stop_everywhere(self._config, safe_state)

    def close(self) -> None:
        pass


async def stop_everywhere(config: ReachyConfig, safe_state: SafeState) -> tuple[MotorReport, ...]:
    """Stop the robot at each address where it may be. Where no daemon runs there is none; each of the
    others has to confirm, since nobody knows which is the robot's. Never raises."""
    try:
        stoppers = [Stopper(host, number) for host, number in config.addresses()]
    except ValueError as error:
        return Outcome(False, False, str(error)).reports(config.axes, config.ids)

    async def stop(stopper: Stopper, scope: trio.CancelScope) -> None:
        if not await stopper.run(safe_state, STOP_S):  # the others are given as long as a connection may take
            scope.deadline = min(scope.deadline, trio.current_time() + CONNECT_S)

    try:
        async with trio.open_nursery() as nursery:
            for stopper in stoppers:
                nursery.start_soon(stop, stopper, nursery.cancel_scope)
    finally:
        for stopper in stoppers:
            stopper.close()
    asked = [stopper for stopper in stoppers if not stopper.nobody_there] or stoppers
    outcome = Outcome(
        written=any(stopper.written for stopper in asked),
        acknowledged=all(stopper.acknowledged for stopper in asked),
        detail=next((stopper.detail for stopper in asked if stopper.detail), ""),
    )
    return outcome.reports(config.axes, config.ids)
