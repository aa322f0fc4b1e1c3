"""Reach the robot's topics over rosbridge: one WebSocket, which keeps the order of all messages.

No message is stored to be sent later. A message that cannot be sent now is an error. A new
connection has no old messages.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Sequence
from itertools import count
from typing import Any, Protocol

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.reporting_base import Report
from strands_actors.drivers.common.ports.exchange import Exchange
from strands_actors.drivers.common.ports.websocket import begin_websocket
from strands_actors.kernel.clock import Clock

from . import messages as m
from . import protocol as p
from .config import YahboomConfig
from .links import News, report_of

CONNECT_S = 0.4
"""Longest time to connect for a stop, before the next attempt."""

JOINTS_S = 0.5
"""Longest silence of a listed joint topic at the start. Some robots list one without publishing on it."""

WATCH_MS = 50.0
"""Shortest interval of odometry on a connection that only stops the base, milliseconds."""

MAX_UNANSWERED = 4
"""Largest number of unacknowledged commands, for 10 Hz and a bridge that answers after 300 ms."""

DIGITS = 19
"""A call's number has fewer digits than this. A longer one is not ours."""

SCAN_MS = 200.0
"""Shortest interval of scans, milliseconds. A scan is 20 kB, so it is requested five times a second."""

IMU_MS = 50.0


ZERO = p.publish(m.CMD_VEL, m.twist_message(m.REST, stop=True))
"""The message that stops the base."""


class Socket(Protocol):
    """The part of a WebSocket that this module uses. ``common.ports.websocket.WebSocket``
    implements it."""

    name: str

    @property
    def is_open(self) -> bool: ...
    @property
    def is_pending(self) -> bool: ...
    def send(self, message: str) -> None: ...
    def send_stop(self, *messages: str) -> None: ...
    async def accepted(self, within_s: float) -> bool: ...
    async def receive(self) -> str | bytes: ...
    def close(self) -> None: ...


class OpenSocket(Protocol):
    def __call__(
        self, host: str, port: int, /, *, within_s: float, stop: Sequence[str] = ()
    ) -> Awaitable[Socket]: ...


class RosbridgeLink:
    def __init__(self, config: YahboomConfig, clock: Clock, open_socket: OpenSocket = begin_websocket) -> None:
        self.news = News()
        self._config = config
        self._clock = clock
        self._open_socket = open_socket
        self._socket: Socket | None = None
        self._numbers = count(1)  # of the service calls
        # For each call its service.
        self._exchange: Exchange[int, str, p.ServiceResponse] = Exchange()
        # Numbers of the calls that follow commands and are not answered yet.
        self._unanswered: list[int] = []
        self._objection = ""  # the last error that rosbridge reported
        self._connecting = trio.Lock()

    @property
    def is_open(self) -> bool:
        return self._socket is not None and (self._socket.is_open or self._socket.is_pending)

    async def open(self) -> dict[str, Any]:
        name, missing = "rosbridge", "no answer"
        with trio.move_on_after(self._config.timeout_s):
            self.close()
            await self._connect(self._config.timeout_s)
            name = self._name
            facts = await self._shake_hands()
            missing = "no odometry"
            await self._until(lambda: self.news.odometry is not None)
            missing = "odometry never changes its stamp"
            await self._until(lambda: self.news.odometry_stamps.goes_on)
            if m.JOINT_STATES in facts["topics"]:
                with trio.move_on_after(JOINTS_S):
                    await self._until(lambda: self.news.joints_ns != 0)
            return facts
        self.close()
        raise WireDown(
            f"{name}: {missing} within {self._config.timeout_s:g} s. Check that rosbridge and the base run"
        )

    async def listen(self) -> None:
        """Connect and subscribe to odometry before a stop is needed. Raise ``WireDown``."""
        async with self._connecting:
            await self._connect(CONNECT_S)
            self._listen((m.ODOMETRY,), WATCH_MS)

    async def connect(self) -> None:
        """Connect for a stop. A zero twist is sent in one write with the request that opens the
        WebSocket. ``acknowledged`` then completes the handshake."""
        async with self._connecting:
            if not self.is_open:
                await self._begin(CONNECT_S, _advertised(m.CMD_VEL), ZERO)

    async def receive_messages(self) -> None:
        await self._until(lambda: False)

    def zero(self) -> None:
        if self._socket is None:
            raise WireDown("rosbridge: not connected. Reconnect")
        self._socket.send_stop(ZERO)

    @property
    def is_behind(self) -> bool:
        return len(self._unanswered) >= MAX_UNANSWERED

    @property
    def has_unacknowledged(self) -> bool:
        return bool(self._unanswered)

    def drive(self, twist: m.Twist) -> None:
        self._command(p.publish(m.CMD_VEL, m.twist_message(twist)))

    def move_arm(self, goal: m.ArmGoal) -> None:
        self._command(p.publish(m.ARM, m.arm_message(goal)))

    async def acknowledged(self, within_s: float) -> None:
        """Wait until the bridge has processed all messages that were sent. It processes them in
        order, so its answer to a last call follows all of them."""
        with trio.move_on_after(within_s):
            if self._socket is not None and self._socket.is_pending:
                await self._accept(self._socket, within_s)
                self._listen((m.ODOMETRY,), WATCH_MS)
            await self._call(p.TIME_SERVICE)
            return
        raise WireDown(f"{self._name}: no answer within {within_s * 1e3:.0f} ms. Check rosbridge and its network")

    async def next_report(self, within_s: float) -> Report:
        before = self.news.odometry
        with trio.move_on_after(within_s):
            await self._until(lambda: self.news.odometry is not before)
        newest = self.news.odometry
        if newest is None or newest is before:
            raise WireDown(f"{self._name}: no odometry within {within_s * 1e3:.0f} ms. Check the base")
        return report_of(newest)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._forget_all()

    # -- the handshake

    @property
    def _name(self) -> str:
        return "rosbridge" if self._socket is None else self._socket.name

    async def _connect(self, within_s: float) -> None:
        await self._accept(await self._begin(within_s), within_s)

    async def _begin(self, within_s: float, *stop: str) -> Socket:
        """Open a new connection, and send ``stop`` together with its upgrade request. The old
        connection stays open until then, because a stop may have no other connection to write on."""
        try:
            host, port = self._config.address()
        except ValueError as error:
            raise WireDown(str(error)) from None
        before = self._socket
        self._socket = await self._open_socket(host, port, within_s=within_s, stop=stop)
        if before is not None:
            before.close()
        self._objection = ""
        self._forget_all()
        return self._socket

    def _forget_all(self) -> None:
        self._unanswered.clear()
        self._exchange.clear()

    async def _accept(self, socket: Socket, within_s: float) -> None:
        """Wait until rosbridge has answered the request that opens the WebSocket. Raise
        ``WireDown``."""
        if not await socket.accepted(within_s):
            raise WireDown(
                f"{socket.name}: no WebSocket within {within_s * 1e3:.0f} ms. Check rosbridge and its network"
            )
        self._advertise()

    async def _shake_hands(self) -> dict[str, Any]:
        """Check that the robot's topics exist with the expected types, and subscribe. Raise
        ``WireDown``."""
        values = await self._call(p.TOPICS_SERVICE)
        types = _types(values)
        for topic, expected in {**m.COMMANDED, **m.REPORTED}.items():
            actual = types.get(topic)
            if actual is None:
                raise WireDown(f"{self._name}: the robot has no topic {topic}. Start the robot's own nodes")
            if actual != expected:
                raise WireDown(f"{self._name}: {topic} is a {actual}, not a {expected}. Is this an M3 Pro?")
        optional = tuple(topic for topic, type_name in m.OPTIONAL.items() if types.get(topic) == type_name)
        self._listen((m.ODOMETRY, *optional))
        # rosbridge reports an error in a subscription before it answers this call.
        await self._call(p.TIME_SERVICE)
        if self._objection:
            raise WireDown(f"{self._name}: rosbridge reports an error: {self._objection}")
        return {"rosbridge": f"ws://{self._name}", "topics": sorted((*m.COMMANDED, *m.REPORTED, *optional))}

    def _advertise(self) -> None:
        for topic in m.COMMANDED:
            self._send(_advertised(topic))

    def _listen(self, topics: tuple[str, ...], at_least_ms: float = 0.0) -> None:
        for topic in topics:
            rate = SCAN_MS if topic in m.SCANS else IMU_MS if topic == m.IMU else at_least_ms
            self._send(p.encode(p.Subscribe(topic, {**m.REPORTED, **m.OPTIONAL}[topic], rate)))

    # -- messages

    def _send(self, text: str) -> None:
        if self._socket is None:
            raise WireDown("rosbridge: not connected. Reconnect")
        self._socket.send(text)

    def _command(self, text: str) -> None:
        """Send a command, then a service call. The answer to the call shows that the bridge has
        processed the command."""
        self._send(text)
        number = next(self._numbers)
        self._unanswered.append(number)
        self._ask(number, p.TIME_SERVICE)

    def _ask(self, number: int, service: str, awaited: bool = False) -> None:
        self._send(p.encode(p.CallService(service, id=str(number))))
        self._exchange.sent(number, service, awaited=awaited)

    async def _call(self, service: str) -> Any:
        """Call a service and return its answer. Raise ``WireDown`` if the answer reports a failure."""
        number = next(self._numbers)
        self._ask(number, service, awaited=True)
        try:
            answer = await self._exchange.answer(number, math.inf, self._receive)
        finally:
            self._exchange.forget(number)
        assert answer is not None, "it waits without a deadline"
        if not answer.result:
            raise WireDown(f"{self._name}: {service} failed ({answer.values}). Check that rosapi runs")
        return answer.values

    async def _until(self, is_so: Callable[[], bool]) -> None:
        await self._exchange.until(is_so, self._receive)

    async def _receive(self) -> None:
        if self._socket is None:
            raise WireDown("rosbridge: not connected. Reconnect")
        self._take(await self._socket.receive())

    def _take(self, message: str | bytes) -> None:
        try:
            match p.decode_incoming(message):
                case p.Publish(topic, content) if topic in m.REPORTED or topic in m.OPTIONAL:
                    self.news.take(topic, m.read_report(topic, content), self._clock.now_ns())
                case p.ServiceResponse(id=str(text)) as answer if text.isdecimal() and len(text) < DIGITS:
                    number = int(text)
                    if self._exchange.take(number, answer) is not None:
                        # The bridge has processed all commands that were sent before this call.
                        self._unanswered = [command for command in self._unanswered if command > number]
                case p.Status(level, text) if level == p.ERROR_LEVEL:
                    self._objection = text
        except MalformedFrame:
            # Only count the message. If a bridge sends nothing else, ``read`` reports it as silent.
            self.news.malformed += 1


def _advertised(topic: str) -> str:
    return p.encode(p.Advertise(topic, m.COMMANDED[topic]))


def _types(values: Any) -> dict[str, str]:
    """Return the type of each topic from an answer of ``/rosapi/topics``; empty for an invalid
    answer."""
    if not isinstance(values, dict):
        return {}
    topics, types = values.get("topics"), values.get("types")
    if not isinstance(topics, list) or not isinstance(types, list):
        return {}
    return {
        topic: m.plain_type(type_name)
        for topic, type_name in zip(topics, types, strict=False)
        if isinstance(topic, str) and isinstance(type_name, str)
    }
