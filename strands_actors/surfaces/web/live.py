"""The WebSocket of a page: it sends the newest values, and receives the operator's hand on the jog buttons.

A page that reads slowly misses values, delays nothing, and never shows old values later.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Sequence
from typing import Annotated, Any, Protocol

import msgspec
import trio
from starlette.websockets import WebSocket

from strands_actors.caller.processes.background import open_background
from strands_actors.contract.axis import Axis
from strands_actors.contract.pose_keys import POSE_KEYS
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.mesh.schemas import Features, is_name
from strands_actors.surfaces.mesh.client import MeshClient

from .access import Access, Role, Session
from .robots import Robots, Watched
from .seat import Hands, Seat, axis_of
from .sockets import BAD_MESSAGE, DISCONNECTED, ENDED, LONGEST_MS, send
from .tools import Tools

FLEET_S = 0.5
STATE_S = 0.1
MOST_AXES = 64


class Watch(msgspec.Struct, tag="watch", forbid_unknown_fields=True):
    """Show this robot. With an empty name, show the fleet only."""

    robot: Annotated[str, msgspec.Meta(max_length=64)]


class UseTool(msgspec.Struct, tag="tool", forbid_unknown_fields=True):
    """Jog the tool of the robot's arm, too."""


class Jog(msgspec.Struct, tag="jog", forbid_unknown_fields=True):
    """The operator's hand, 30 times a second while it is on a button, and once when it has let go.

    Attributes:
        held: True while a button is pressed.
        at_ms: Time on the page's clock in milliseconds.
        rates: Speed by axis, as a share (-1 to 1) of the axis' speed for jogging.
    """

    held: bool
    at_ms: Annotated[float, msgspec.Meta(ge=0.0, le=LONGEST_MS)]
    rates: Annotated[dict[str, float], msgspec.Meta(max_length=MOST_AXES)] = {}


class Feed(Protocol):
    """Messages of one feature for every page.

    ``count`` is the number of its changes so far.
    """

    count: int

    def news(self, since: int, role: Role) -> dict[str, Any] | None:
        """Return the message for a page that knows the first ``since`` changes; None if this role sees nothing."""


_decode = msgspec.json.Decoder(Watch | Jog | UseTool).decode
_encode = msgspec.json.Encoder().encode


class Conversation:
    """The conversation with one page.

    Args:
        socket: The WebSocket, which is accepted.
        client: The client of the mesh.
        robots: The newest samples.
        hands: The robots that are moved by pages.
        tools: The tools of arms.
        access: The sessions.
        session: The session of this page.
        feeds: The features that have messages for every page.
    """

    def __init__(
        self,
        socket: WebSocket,
        client: MeshClient,
        robots: Robots,
        hands: Hands,
        tools: Tools,
        access: Access,
        session: Session,
        feeds: Sequence[Feed] = (),
    ) -> None:
        self._shown = [(feed, -1) for feed in feeds]
        self._hands = hands
        self._tools = tools
        self._socket = socket
        self._client = client
        self._robots = robots
        self._access = access
        self._session = session
        self._robot = ""
        self._seat: Seat | None = None
        self._seat_scope = trio.CancelScope()
        self._shown_count = self._shown_events = 0
        self._notes: list[dict[str, Any]] = []

    async def run(self) -> None:
        """Serve the page until it disconnects. A robot that it moves holds its position then."""
        with contextlib.suppress(*DISCONNECTED):
            async with open_background() as nursery:
                self._nursery = nursery
                async with trio.open_nursery() as both:
                    both.start_soon(self._show)
                    try:
                        await self._listen()
                    finally:
                        both.cancel_scope.cancel()

    async def _listen(self) -> None:
        while True:
            try:
                message = _decode(await self._socket.receive_text())
            except (msgspec.MsgspecError, RecursionError, KeyError):
                await self._socket.close(BAD_MESSAGE, "this page is of another version. Load it again")
                return
            if isinstance(message, Watch):
                await self._watch(message.robot)
            elif self._seat is None:
                continue
            elif isinstance(message, UseTool):
                self._nursery.start_soon(self._ready_tool, self._seat)
            else:
                self._seat.operate(message.held, message.at_ms, message.rates)

    async def _watch(self, robot: str) -> None:
        """Show another robot. A seat in front of the robot before is left, so that robot holds its position."""
        self._seat_scope.cancel()
        self._seat = None
        self._robot = robot if is_name(robot) else ""
        self._shown_count = self._shown_events = 0
        if not self._robot:
            return
        features = await self._client.request(self._robot, Features())
        if isinstance(features, Refused):
            self._notes.append({"type": "axes", "robot": robot, "axes": {}, "reason": features.text})
            return
        described = features.get("axes", {})
        self._notes.append({"type": "axes", "robot": robot, "axes": described})
        if self._session.role is Role.OPERATOR:
            await self._nursery.start(
                self._sit, robot, tuple(axis_of(key, each) for key, each in described.items())
            )

    async def _sit(
        self, robot: str, axes: tuple[Axis, ...], task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED
    ) -> None:
        def tell(state: str, reason: str) -> None:
            self._notes.append({"type": "seat", "robot": robot, "state": state, "reason": reason})

        with trio.CancelScope() as self._seat_scope:
            seat = self._seat = Seat(self._hands, self._client, robot, axes, tell, time.monotonic_ns)
            task_status.started()
            await seat.run()

    async def _ready_tool(self, seat: Seat) -> None:
        """Let the page move the tool of an arm, once its model is built. A page asks for it, because that takes a
        second of computing or more."""
        robot = self._robots.get(seat.robot)
        presence = None if robot is None else robot.viewer.presence
        tool = None if presence is None else await self._tools.get(presence.hw, presence.model_units)
        if tool is not None:
            seat.use_tool(tool)
        keys = () if tool is None else POSE_KEYS
        self._notes.append({"type": "tool", "robot": seat.robot, "keys": keys})

    # -- show

    async def _show(self) -> None:
        next_fleet = -math.inf
        while True:
            if not self._access.holds(self._session):
                await self._socket.close(ENDED, "this device was sent away")
                return
            now = trio.current_time()
            if now >= next_fleet:
                next_fleet = now + FLEET_S
                await send(self._socket, self._robots.fleet())
            for index, (feed, shown_count) in enumerate(self._shown):
                if feed.count != shown_count:
                    self._shown[index] = feed, feed.count
                    news = feed.news(shown_count, self._session.role)
                    if news is not None:
                        await self._send(news)
            while self._notes:
                await self._send(self._notes.pop(0))
            robot = self._robots.get(self._robot) if self._robot else None
            if robot is not None:
                await self._show_robot(robot)
            await trio.sleep(STATE_S / 2)

    async def _show_robot(self, robot: Watched) -> None:
        if robot.viewer.readings != self._shown_count and robot.joints is not None:
            if self._shown_count == 0 or robot.viewer.readings % 10 == 0:
                await self._send({"type": "facts", "robot": robot.name, "topics": robot.topics})
            self._shown_count = robot.viewer.readings
            await self._send({"type": "reading", "reading": robot.joints})
        new = robot.event_count - self._shown_events
        if new:
            self._shown_events = robot.event_count
            events = list(robot.events)[-new:]
            await self._send({"type": "events", "robot": robot.name, "events": events})

    async def _send(self, message: dict[str, Any]) -> None:
        await send(self._socket, _encode(message).decode())
