"""The server of a simulated robot with one client at a time.

It notes the time of received bytes, logs them and passes them to the robot. It sends each reply when it is due.
"""

from __future__ import annotations

import heapq
import itertools
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import trio

from strands_actors.drivers.common.physics.body import Body, body_of

from .alarm import NS, new_alarm
from .faults import Reply, parse_fault
from .line import Channel, Line
from .robot import Controls, HasControlLines, TwinRobot
from .wirelog import WireLog

BITS_PER_BYTE = 10  # a start bit, 8 data bits and a stop bit (8N1)

EVENTS_S = 0.02
"""Period in which the events on a robot's body are logged."""

SHORT_WAIT_S = 0.002
"""Waits up to this long block the process until the host sends bytes. This costs half as much as a turn
of the event loop, and a twin has nothing else to do."""


class Exchange(NamedTuple):
    """One frame that the robot has received, and the robot's replies to it in order."""

    kind: str
    request: bytes
    replies: Sequence[Reply]
    safe_state: str | None = None  # safe state that this frame alone brings the robot to; None if unknown


class TwinSession(Protocol):
    """The robot's side of a connection with one client. Pure, except that the simulated body reads the time."""

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        """Carry out received frames, and yield one ``Exchange`` (the frame and its replies) per frame. The caller
        logs each exchange before it requests the next one.

        Args:
            data: Received bytes, in pieces of any size.
            bits_per_s: The client's bit rate; None if the transfer of bytes takes no time.
        """
        ...


@runtime_checkable
class HasEvents(Protocol):
    """A simulated robot on whose body something may happen without a request."""

    @property
    def has_events(self) -> bool:
        """False if this body has no events."""
        ...

    def events(self) -> Sequence[tuple[str, bytes]]:
        """Return what happened since the last call: kind and bytes of each entry for the log."""
        ...


class Robot(TwinSession, Controls, Protocol):
    """The methods that a server needs from a simulated robot with a single client."""


class Frost:
    """A freeze of the simulated robot. As long as it lasts, the robot neither reads nor answers."""

    def __init__(self) -> None:
        self._thaw_s = 0.0

    def freeze(self, seconds: float) -> None:
        self._thaw_s = trio.current_time() + seconds

    async def thawed(self) -> None:
        if trio.current_time() < self._thaw_s:
            await trio.sleep_until(self._thaw_s)

    async def every(self, period_s: float, step: Callable[[], None]) -> None:
        """Call ``step`` once per period until cancelled, except while the robot is frozen. After a delay, at most
        one of the missed calls is made."""
        period_ns = round(period_s * NS)
        due_ns = time.monotonic_ns()
        # trio's own sleep would take as much computing time as a step of a simulated arm.
        alarm = new_alarm()
        try:
            while True:
                await self.thawed()
                # Other tasks that woke up at the same time should first read the bytes that have arrived.
                await trio.lowlevel.checkpoint()
                step()
                due_ns = max(due_ns + period_ns, time.monotonic_ns() - period_ns)
                alarm.set(due_ns)
                await alarm.ring()
        finally:
            alarm.close()


class _Departure(NamedTuple):
    due_ns: int
    order: int
    frames: list[tuple[str, bytes]]


class Conversation:
    """The connection with one client: it passes requests to the session, and sends the replies when they are
    due."""

    def __init__(
        self, session: TwinSession, channel: Channel, log: WireLog, frost: Frost, *, wire_time: bool = True
    ) -> None:
        """Prepare the connection with one client.

        Args:
            wire_time: True if a reply takes as long as its bytes take at the client's bit rate.
        """
        self._session = session
        self._channel = channel
        self._log = log
        self._frost = frost
        self._wire_time = wire_time
        self._alarm = new_alarm()
        self._departures: list[_Departure] = []
        self._order = itertools.count()
        self._line_free_ns = 0

    async def serve(self) -> None:
        """Read requests and send replies until cancelled."""
        try:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self._read)
                nursery.start_soon(self._send)
        finally:
            self._alarm.close()

    async def serve_replies(self) -> None:
        """Send replies until cancelled. Other code must read the client's frames and pass them to
        ``handle_received``."""
        try:
            await self._send()
        finally:
            self._alarm.close()

    def handle_received(self, exchange: Exchange, t_ns: int) -> None:
        """Log the received frame of an exchange, and send its replies when they are due."""
        self._log.write(t_ns, "host", [(exchange.kind, exchange.request)], exchange.safe_state)
        self._schedule(exchange, t_ns, self._channel.bits_per_s())

    async def _read(self) -> None:
        while True:
            t_ns, data = await self._channel.receive()
            await self._frost.thawed()
            rate = self._channel.bits_per_s()
            for exchange in self._session.receive(data, rate):
                self._log.write(t_ns, "host", [(exchange.kind, exchange.request)], exchange.safe_state)
                self._schedule(exchange, t_ns, rate)

    def _schedule(self, exchange: Exchange, t_ns: int, rate: int | None) -> None:
        byte_ns = BITS_PER_BYTE * NS // rate if rate and self._wire_time else 0
        due_ns = max(t_ns, self._line_free_ns) + len(exchange.request) * byte_ns
        in_time: list[tuple[str, bytes]] = []
        for reply in exchange.replies:
            frame = (reply.kind, reply.data)
            on_wire_ns = round(reply.delay_s * NS) + len(reply.data) * byte_ns
            if reply.late_s:
                self._depart(due_ns + on_wire_ns + round(reply.late_s * NS), [frame])
                continue
            due_ns += on_wire_ns
            in_time.append(frame)
        self._line_free_ns = due_ns
        # All replies that are due together are sent at once, as from the buffer of a serial adapter.
        if in_time:
            self._depart(due_ns, in_time)

    def _depart(self, due_ns: int, frames: list[tuple[str, bytes]]) -> None:
        wait_s = (due_ns - time.monotonic_ns()) / NS
        if wait_s <= 0 or (wait_s < SHORT_WAIT_S and self._channel.quiet_for(wait_s)):
            self._write(frames)
            return
        heapq.heappush(self._departures, _Departure(due_ns, next(self._order), frames))
        self._alarm.set(self._departures[0].due_ns)

    async def _send(self) -> None:
        while True:
            await self._alarm.ring()
            await self._frost.thawed()
            while self._departures and self._departures[0].due_ns <= time.monotonic_ns():
                self._write(heapq.heappop(self._departures).frames)
            if self._departures:
                self._alarm.set(self._departures[0].due_ns)

    def _write(self, frames: list[tuple[str, bytes]]) -> None:
        # Log before sending, so that the log contains every frame that the client has received.
        self._log.write(time.monotonic_ns(), "robot", frames)
        self._channel.send(b"".join(data for _, data in frames))


class TwinServer(ABC):
    """Serve one simulated robot. The public methods cause events while it runs."""

    def __init__(self, robot: Controls, log: WireLog) -> None:
        self._robot = robot
        self._log = log
        self._frost = Frost()

    @property
    @abstractmethod
    def address(self) -> str:
        """Return the path or address to which clients connect."""

    @property
    def body(self) -> Body:
        """The robot's simulated body. Raise ``ValueError`` if it has no body."""
        return body_of(self._robot)

    @abstractmethod
    def plug(self) -> None:
        """Plug the robot's cable in."""

    @abstractmethod
    def unplug(self) -> None:
        """Pull the robot's cable. The robot does not notice it."""

    def set_fault(self, text: str) -> None:
        """Set a fault: ``WORD`` (its name, such as ``stuck``) for the robot, or ``WORD:number`` for one motor or
        part. Raise ``ValueError`` for any other text."""
        robot = self._robot
        was_off = self._is_off
        robot.set_fault(*parse_fault(text))
        if isinstance(robot, TwinRobot) and robot.RESTART_CUTS and robot.is_off is not was_off:
            self.plug() if was_off else self.unplug()

    @property
    def _is_off(self) -> bool:
        return isinstance(self._robot, TwinRobot) and self._robot.is_off

    def power_cycle(self) -> None:
        """Switch the robot's power off and on. This may end every connection (see ``TwinRobot.RESTART_CUTS``)."""
        self._robot.power_cycle()
        if isinstance(self._robot, TwinRobot) and self._robot.RESTART_CUTS:
            self.unplug()
            if not self._is_off:
                self.plug()

    def freeze(self, seconds: float) -> None:
        """Stop reading and answering for ``seconds``. Then the robot handles the bytes that have waited."""
        self._frost.freeze(seconds)

    def order(self, words: Sequence[str]) -> bool:
        """Carry out a control line of this robot. Return False if it does not know the line."""
        return isinstance(self._robot, HasControlLines) and self._robot.order(words)

    async def serve(self) -> None:
        """Serve the robot's clients, and run its control cycle, until cancelled."""
        async with trio.open_nursery() as nursery:
            self.start(nursery)
            if isinstance(self._robot, TwinRobot) and self._robot.TICK_S:
                nursery.start_soon(self._frost.every, self._robot.TICK_S, self._robot.tick)

    @abstractmethod
    def start(self, nursery: trio.Nursery) -> None:
        """Start the tasks that serve the clients."""

    @abstractmethod
    def close(self) -> None:
        """Close the ports at the end of the process."""


class Server(TwinServer):
    """Serve one simulated robot on one cable."""

    def __init__(self, robot: Robot, line: Line, log: WireLog, *, wire_time: bool = True) -> None:
        super().__init__(robot, log)
        self._line = line
        self._conversation = Conversation(robot, line, log, self._frost, wire_time=wire_time)

    @property
    def address(self) -> str:
        return self._line.address

    def plug(self) -> None:
        self._line.plug()

    def unplug(self) -> None:
        self._line.unplug()

    def start(self, nursery: trio.Nursery) -> None:
        nursery.start_soon(self._conversation.serve)
        if isinstance(self._robot, HasEvents) and self._robot.has_events:
            nursery.start_soon(self._frost.every, EVENTS_S, partial(self._log_events, self._robot))

    def _log_events(self, robot: HasEvents) -> None:
        self._log.write(time.monotonic_ns(), "robot", robot.events())

    def close(self) -> None:
        self._line.close()
