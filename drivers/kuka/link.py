"""An FRI session on its socket: receive messages, answer them, and bring the arm to a stand.

The wire uses it for its whole life. The stop channel uses it after the wire has ended.

An arm counts as held when two answers have left since the stop began and the measured positions stand still.
In a session that follows our answers, the controller must also have taken one of them: an answer may be lost,
and an arm stands still at the end of every step.
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
"""Most datagrams to process at once, so that a flood cannot delay an answer further. The system buffers no
more for a socket."""
MOST_READ = 64
"""Number of the newest of these that are decoded. One message takes 0.1 ms."""
STANDING_RAD_S = 0.02
STAND_S = 0.03
"""Time between two positions that are compared to see whether the arm stands still."""
ALONE_STAND_S = 0.1
"""The same for an arm that does not follow our answers [assumed]. A joint that nothing holds begins to fall
from rest, and stands almost still in its first hundredths of a second."""
HEAR_S = 0.3
"""A controller that sends nothing for this long counts as absent."""
CONFIRM_S = 0.8
"""Longest time in which an arm at full speed comes to a stand [?]."""
QUIET_CYCLES = 2.5
"""After this many cycles without a message, a hold is sent without a request."""


class Link:
    """One session. ``port`` has received ``said`` from its controller."""

    def __init__(self, port: UdpListener, arm: Arm, clock: Clock, said: Monitoring) -> None:
        self.port = port
        self.session = FriSession(arm.speed_rad_s)
        self.session.hear(said)
        self.said = said
        self.heard_ns = self._written_ns = clock.now_ns()
        self.answers = 0
        self.news = trio.Event()  # set, and replaced, with each valid message
        self._clock = clock
        self._arm = arm
        # The positions of the last ALONE_STAND_S, and one earlier position.
        self._seen: deque[tuple[int, tuple[float, ...]]] = deque()
        self._inbox = Inbox(port)

    async def hear(self) -> Monitoring:
        """Wait for a new, valid message. Return the newest. Raise ``WireDown``."""
        while True:
            # Noise and repeated messages do not count: the silence is measured from the last valid message.
            news = [said for said in self._inbox.messages(await self.port.read()) if self.session.hear(said)]
            if news:
                self._take(news[-1])
                return news[-1]

    def _take(self, said: Monitoring) -> None:
        if (said.sequence - self.said.sequence) & COUNTER > LATE:
            self._seen.clear()  # Only consecutive messages can show that the arm stands still.
        self.said, self.heard_ns = said, self._clock.now_ns()
        self._seen.append((self.heard_ns, said.position))
        while len(self._seen) > 2 and self.heard_ns - self._seen[1][0] >= ALONE_STAND_S * NS:
            self._seen.popleft()
        self.news.set()
        self.news = trio.Event()

    def answer(self, said: Monitoring) -> None:
        """Answer a message if an answer is due. Raise ``WireDown``."""
        if self.session.is_due(said):
            self._write(self.session.answer(said))
            self.answers += 1

    def _write(self, command: Command) -> None:
        self.port.write(encode_command(command))
        self._written_ns = self._clock.now_ns()

    @property
    def state(self) -> str:
        """The name of the session's state."""
        return name_of(State, self.said.state)

    def silent_s(self) -> float:
        """Return the time since the last valid message."""
        return (self._clock.now_ns() - self.heard_ns) / NS

    # -- to a stand

    async def bring_to_stand(self, cycle: Callable[[], Awaitable[None]], detail: str) -> tuple[MotorReport, ...]:
        """Wait until the arm is held, as defined at the top of this module. Never raises.

        Args:
            cycle: Returns when the next message has been answered. Raises ``WireDown``.
            detail: The detail of the reports if nothing fails.
        """
        first, hold, failure = self.answers, self.session.next_number(self.said), ""
        quiet_s = QUIET_CYCLES * cycle_s(self.said)
        written = False
        self._seen.clear()
        try:
            with trio.move_on_after(CONFIRM_S):
                while not self._is_held(first, hold):
                    # No message asks for an answer. The controller may still receive one. It is repeated,
                    # because a datagram may be lost.
                    if self._clock.now_ns() - self._written_ns >= round(quiet_s * NS):
                        written = self.hold_unasked()
                    with trio.move_on_after(quiet_s):
                        await cycle()
        except WireDown as down:
            failure = str(down)
        written = written or self.answers > first
        return self.reports(written, self._is_taken(hold), self._is_held(first, hold), failure or detail)

    def hold_unasked(self) -> bool:
        """Send a hold in answer to an old message, as the controller may still receive. Return True. Raise
        ``WireDown``."""
        self._write(self.session.again(self.said))
        return True

    @property
    def _follows_us(self) -> bool:
        """Whether the arm follows our answers. Otherwise they neither move nor hold it."""
        return self.said.state == State.COMMANDING_ACTIVE

    def _is_held(self, first: int, hold: int) -> bool:
        """Return whether the arm is held, as defined at the top of this module.

        Args:
            first: The number of sent answers when the stop began.
            hold: The sequence number of the first answer that holds.
        """
        if self.answers - first < 2 or not self._stands():
            return False
        return self._is_taken(hold) or not self._follows_us

    def _is_taken(self, hold: int) -> bool:
        """Return whether the controller reports that it has taken an answer that holds."""
        return self.session.has_received_answer(self.said, hold)

    def _stands(self) -> bool:
        """Return whether the positions of the newest messages stand still.

        They are checked in every state of the session, because the robot's behaviour in its own stop, with
        drives off, is not known.
        """
        if not self._seen:
            return False
        at_least_s = STAND_S if self._follows_us else ALONE_STAND_S
        now_ns, now = self._seen[-1]
        for then_ns, before in reversed(self._seen):
            span_s = (now_ns - then_ns) / NS
            if span_s >= at_least_s:
                moved = max(abs(rad - other) for rad, other in zip(now, before, strict=True))
                return moved <= STANDING_RAD_S * span_s
        return False

    def reports(self, written: bool, taken: bool, held: bool, detail: str) -> tuple[MotorReport, ...]:
        """Return a report per joint."""
        alone = f"FRI session is {self.state}" if self.said.state < State.COMMANDING_WAIT else ""
        if held and alone:
            detail = f"{alone}: {self._holder()}"
        elif not held and not detail:
            detail = self._reason_not_held(taken, alone)
        return _reports(self._arm, written, taken, held, detail, self.session.commanded)

    def _holder(self) -> str:
        """Return what holds an arm that stands still and does not follow us, as far as the message shows."""
        said = self.said
        if said.safety or any(drive != Drive.ACTIVE for drive in said.drives):
            return "it stands, in a stop of the robot's own"
        return "the robot's own program holds it"

    def _reason_not_held(self, taken: bool, alone: str) -> str:
        if self.silent_s() > STAND_S:
            return f"no FRI message for {self.silent_s() * 1e3:.0f} ms"
        if not self._stands():
            return f"{alone}, and it still moves" if alone else "it still moves"
        if self._follows_us and not taken:
            return "the controller has taken none of our answers"
        return "it asks for no answers"


def cycle_s(said: Monitoring) -> float:
    """Return the time between two answers."""
    return said.sample_ms * said.multiplier / 1e3


async def answer_instead(
    port: UdpListener, arm: Arm, clock: Clock, at_least_s: float, detail: str
) -> tuple[MotorReport, ...] | None:
    """Answer in place of an earlier client until the arm stands still.

    The answers have the last commanded position that the controller reports, and continue its sequence
    numbers.

    Args:
        at_least_s: Shortest time to answer.
        detail: The detail of the reports if nothing fails.

    Returns:
        The reports; None if the controller sends nothing.

    Raises:
        WireDown: The port fails.
    """
    began_ns = clock.now_ns()
    said: Monitoring | None = None
    with trio.move_on_after(HEAR_S):
        said = await first_message(port)
    if said is None:
        return None
    link = Link(port, arm, clock, said)

    async def cycle() -> None:
        link.answer(await link.hear())

    link.answer(said)
    reports = await link.bring_to_stand(cycle, detail)
    with trio.move_on_after(max(0.0, at_least_s - (clock.now_ns() - began_ns) / NS)):
        while True:
            await cycle()
    return reports


def failed(arm: Arm, why: str, written: bool = False) -> tuple[MotorReport, ...]:
    """Report every joint as not confirmed."""
    return _reports(arm, written, False, False, why)


def _reports(
    arm: Arm, written: bool, taken: bool, held: bool, detail: str, target: Sequence[float] = ()
) -> tuple[MotorReport, ...]:
    """Return the same report for every joint, since one answer commands all joints."""
    return tuple(
        MotorReport(axis, at + 1, written, taken, held, detail, target[at] if held and target else None)
        for at, axis in enumerate(arm.axes)
    )


async def first_message(port: UdpListener) -> Monitoring:
    """Return the newest message of the first controller that sends.

    A controller in a commanding state is accepted only after ``RUN`` consecutive messages: a single one may be
    old. Raise ``WireDown``.
    """
    met: list[bytes] = []

    def is_controller(data: bytes) -> bool:
        met[:] = [data]
        return understood(data) is not None

    await port.meet(is_controller)
    inbox, data = Inbox(port), met[-1]
    run: list[Monitoring] = []
    while True:
        for said in inbox.messages(data):
            run = [*run, said] if follow_each_other(run, said) else [said]
        if run and (run[-1].state < State.COMMANDING_WAIT or len(run) >= RUN):
            return run[-1]
        data = await port.read()


class Inbox:
    """The datagrams that wait at a port."""

    def __init__(self, port: UdpListener) -> None:
        self._port = port
        self._budget = ReceiveBudget("the FRI session", MOST_WAITING, MOST_WAITING * LARGEST)

    def messages(self, first: bytes) -> Iterator[Monitoring]:
        """Yield the valid messages among ``first`` and the waiting datagrams. Raise ``WireDown`` for a peer that
        sends too much."""
        waiting = [first, *self._budget.turn(self._port.read_waiting)]
        return filter(None, map(understood, waiting[-MOST_READ:]))


def understood(data: bytes) -> Monitoring | None:
    try:
        return decode_monitoring(data)
    except MalformedFrame:
        return None
