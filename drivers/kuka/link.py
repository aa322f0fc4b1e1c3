"""Keep an FRI session: receive the controller's messages, answer them, and bring the arm to a standstill.

The wire process uses this code during its whole life. The stop channel uses it after the wire process has ended.

The arm counts as held if two conditions hold. At least two answers were sent since the stop began, and the measured
positions do not change. If the session is in COMMANDING_ACTIVE, the controller must also have acknowledged one of
these answers. An answer may be lost, and then the arm would stand still only because its last step has ended.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Sequence

import trio

from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.receive_budget import ReceiveBudget
from strands_actors.drivers.common.ports.udp_port import UdpListener
from strands_actors.kernel.clock import NS, Clock

from .protocol import (
    COUNTER,
    LARGEST,
    Command,
    Drive,
    Monitoring,
    State,
    decode_monitoring,
    encode_command,
    name_of,
)
from .robots import Arm
from .session import LATE, RUN, FriSession, follow_each_other

MOST_WAITING = 256
"""Most datagrams to read at once, so that a flood of datagrams cannot delay an answer for long. The system buffers
no more for a socket."""
MOST_READ = 64
"""Of the datagrams that were read at once, only this many of the newest are decoded. One takes 0.1 ms."""
STANDING_RAD_S = 0.02
STAND_S = 0.03
"""Time between two positions that are compared to see whether the arm stands still."""
ALONE_STAND_S = 0.1
"""The same time for an arm that does not follow our answers [assumed]. A joint that is not held falls slowly in the
first hundredths of a second, so this time is longer."""
HEAR_S = 0.3
"""A controller from which no message arrives for this time counts as absent."""
CONFIRM_S = 0.8
"""Longest time in which an arm at full speed comes to a standstill [?]."""
QUIET_CYCLES = 2.5
"""During a stop, after this many cycles without a message, a hold is sent although no message requests it."""


class Link:
    """One FRI session on the UDP port ``port``. ``message`` is the first message that the controller has sent."""

    def __init__(self, port: UdpListener, arm: Arm, clock: Clock, message: Monitoring) -> None:
        self.port = port
        self.session = FriSession(arm.speed_rad_s)
        self.session.accept(message)
        self.message = message
        self.last_received_ns = self._written_ns = clock.now_ns()
        self.answers = 0
        self.news = trio.Event()  # Set at each valid message, and then replaced by a new event.
        self._clock = clock
        self._arm = arm
        # Time and position of each message of the last ALONE_STAND_S, and of one earlier message.
        self._history: deque[tuple[int, tuple[float, ...]]] = deque()
        self._inbox = Inbox(port)

    async def receive(self) -> Monitoring:
        """Wait for a new, valid message. If several have arrived, return the newest. Raise ``WireDown``."""
        while True:
            # Malformed and repeated messages are ignored, so they do not reset the time since the last message.
            news = [
                message for message in self._inbox.messages(await self.port.read()) if self.session.accept(message)
            ]
            if news:
                self._take(news[-1])
                return news[-1]

    def _take(self, message: Monitoring) -> None:
        if (message.sequence - self.message.sequence) & COUNTER > LATE:
            self._history.clear()  # After a gap, earlier positions cannot show that the arm stands still.
        self.message, self.last_received_ns = message, self._clock.now_ns()
        self._history.append((self.last_received_ns, message.position))
        while len(self._history) > 2 and self.last_received_ns - self._history[1][0] >= ALONE_STAND_S * NS:
            self._history.popleft()
        self.news.set()
        self.news = trio.Event()

    def answer(self, message: Monitoring) -> None:
        """Send the answer to a message, if the controller expects one in this cycle. Raise ``WireDown``."""
        if self.session.is_due(message):
            self._write(self.session.answer(message))
            self.answers += 1

    def _write(self, command: Command) -> None:
        self.port.write(encode_command(command))
        self._written_ns = self._clock.now_ns()

    @property
    def state(self) -> str:
        """The name of the state that the controller reports for the session, such as COMMANDING_ACTIVE."""
        return name_of(State, self.message.state)

    def silent_s(self) -> float:
        """Return the time in seconds since the controller's last valid message."""
        return (self._clock.now_ns() - self.last_received_ns) / NS

    # -- stop the arm and confirm that it stands still

    async def bring_to_stand(self, cycle: Callable[[], Awaitable[None]], detail: str) -> tuple[MotorReport, ...]:
        """Wait until the arm is held, as defined at the top of this module. Never raises.

        Args:
            cycle: Waits until the next message has been answered. Raises ``WireDown``.
            detail: The text for the reports if the arm is held.
        """
        first, hold, failure = self.answers, self.session.next_number(self.message), ""
        quiet_s = QUIET_CYCLES * cycle_s(self.message)
        written = False
        self._history.clear()
        try:
            with trio.move_on_after(CONFIRM_S):
                while not self._is_held(first, hold):
                    # No message arrives, but the controller may still receive answers. So send a hold, and repeat
                    # it, because a datagram may be lost.
                    if self._clock.now_ns() - self._written_ns >= round(quiet_s * NS):
                        written = self.hold_unasked()
                    with trio.move_on_after(quiet_s):
                        await cycle()
        except WireDown as down:
            failure = str(down)
        written = written or self.answers > first
        return self.reports(written, self._is_acknowledged(hold), self._is_held(first, hold), failure or detail)

    def hold_unasked(self) -> bool:
        """Send an answer that holds the arm although no new message has arrived: the controller may still receive
        it.

        Return True after it was sent. Raise ``WireDown`` if it cannot be sent.
        """
        self._write(self.session.again(self.message))
        return True

    @property
    def _follows_us(self) -> bool:
        """True if the controller moves the arm to the positions in our answers. Else the answers have no effect."""
        return self.message.state == State.COMMANDING_ACTIVE

    def _is_held(self, first: int, hold: int) -> bool:
        """Return whether the arm is held, as defined at the top of this module.

        Args:
            first: How many answers had been sent when the stop began.
            hold: The sequence number of the first answer that holds the arm.
        """
        if self.answers - first < 2 or not self._stands():
            return False
        return self._is_acknowledged(hold) or not self._follows_us

    def _is_acknowledged(self, hold: int) -> bool:
        """Return True if the controller has acknowledged answer ``hold``, the first that holds the arm, or a later
        answer."""
        return self.session.has_received_answer(self.message, hold)

    def _stands(self) -> bool:
        """Return True if the positions in the newest messages show that the arm stands still.

        This is checked in every state of the session. It is unknown how the robot behaves in a safety stop with
        its drives off.
        """
        if not self._history:
            return False
        at_least_s = STAND_S if self._follows_us else ALONE_STAND_S
        now_ns, now = self._history[-1]
        for then_ns, before in reversed(self._history):
            span_s = (now_ns - then_ns) / NS
            if span_s >= at_least_s:
                moved = max(abs(rad - rad_before) for rad, rad_before in zip(now, before, strict=True))
                return moved <= STANDING_RAD_S * span_s
        return False

    def reports(self, written: bool, acknowledged: bool, held: bool, detail: str) -> tuple[MotorReport, ...]:
        """Return a report on the stop of each joint."""
        alone = f"FRI session is {self.state}" if self.message.state < State.COMMANDING_WAIT else ""
        if held and alone:
            detail = f"{alone}: {self._holder()}"
        elif not held and not detail:
            detail = self._reason_not_held(acknowledged, alone)
        return _reports(self._arm, written, acknowledged, held, detail, self.session.commanded)

    def _holder(self) -> str:
        """Return a text that names what holds the arm while it does not follow our answers."""
        message = self.message
        if message.safety or any(drive != Drive.ACTIVE for drive in message.drives):
            return "the arm stands still, stopped by the robot itself"
        return "the robot's own program holds it"

    def _reason_not_held(self, acknowledged: bool, alone: str) -> str:
        if self.silent_s() > STAND_S:
            return f"no FRI message for {self.silent_s() * 1e3:.0f} ms"
        if not self._stands():
            return f"{alone}, and the arm still moves" if alone else "the arm still moves"
        if self._follows_us and not acknowledged:
            return "the controller has acknowledged no answer since the stop"
        return "the controller sends no messages to answer"


def cycle_s(message: Monitoring) -> float:
    """Return the time between two answers in seconds, from the settings that the controller reports."""
    return message.sample_ms * message.multiplier / 1e3


async def answer_instead(
    port: UdpListener, arm: Arm, clock: Clock, at_least_s: float, detail: str
) -> tuple[MotorReport, ...] | None:
    """Take over a session from a client that has ended: answer the controller until the arm stands still.

    The answers contain the last commanded position that the controller reports. Their sequence numbers continue
    those of the earlier client.

    Args:
        port: The UDP port at which the controller's messages arrive.
        arm: The robot.
        clock: The clock.
        at_least_s: Answer for at least this time, even if the arm stands still earlier.
        detail: The text for the reports if the arm is held.

    Returns:
        A report per joint. None if the controller sends nothing.

    Raises:
        WireDown: The port fails.
    """
    began_ns = clock.now_ns()
    message: Monitoring | None = None
    with trio.move_on_after(HEAR_S):
        message = await first_message(port)
    if message is None:
        return None
    link = Link(port, arm, clock, message)

    async def cycle() -> None:
        link.answer(await link.receive())

    link.answer(message)
    reports = await link.bring_to_stand(cycle, detail)
    with trio.move_on_after(max(0.0, at_least_s - (clock.now_ns() - began_ns) / NS)):
        while True:
            await cycle()
    return reports


def failed(arm: Arm, reason: str, written: bool = False) -> tuple[MotorReport, ...]:
    """Return reports in which no joint is confirmed to stand still. ``reason`` says why."""
    return _reports(arm, written, False, False, reason)


def _reports(
    arm: Arm, written: bool, acknowledged: bool, held: bool, detail: str, target: Sequence[float] = ()
) -> tuple[MotorReport, ...]:
    """Return a report on the stop for each joint. All are equal, because each answer commands all joints
    together."""
    return tuple(
        MotorReport(
            axis, index + 1, written, acknowledged, held, detail, target[index] if held and target else None
        )
        for index, axis in enumerate(arm.axes)
    )


async def first_message(port: UdpListener) -> Monitoring:
    """Wait for a controller and return its newest message. The first controller that sends is used.

    If the session is in a commanding state, ``RUN`` consecutive messages are required, because a single message may
    be an old one. Raise ``WireDown`` if the port fails.
    """
    first_datagrams: list[bytes] = []

    def is_controller(data: bytes) -> bool:
        first_datagrams[:] = [data]
        return decoded(data) is not None

    await port.meet(is_controller)
    inbox, data = Inbox(port), first_datagrams[-1]
    run: list[Monitoring] = []
    while True:
        for message in inbox.messages(data):
            run = [*run, message] if follow_each_other(run, message) else [message]
        if run and (run[-1].state < State.COMMANDING_WAIT or len(run) >= RUN):
            return run[-1]
        data = await port.read()


class Inbox:
    """The datagrams that have arrived at a port and were not read yet."""

    def __init__(self, port: UdpListener) -> None:
        self._port = port
        self._budget = ReceiveBudget("the FRI session", MOST_WAITING, MOST_WAITING * LARGEST)

    def messages(self, first: bytes) -> Iterator[Monitoring]:
        """Yield the valid messages among ``first`` and the waiting datagrams.

        Raise ``WireDown`` if the peer sends more than this process can read.
        """
        waiting = [first, *self._budget.turn(self._port.read_waiting)]
        return filter(None, map(decoded, waiting[-MOST_READ:]))


def decoded(data: bytes) -> Monitoring | None:
    try:
        return decode_monitoring(data)
    except MalformedFrame:
        return None
