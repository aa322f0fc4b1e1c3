"""An FRI session on its socket: the newest message heard, its answer, and how an arm is brought to
stand.

Wire and stop channel use it alike: the one answers for as long as it lives, the other once the wire
is gone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Sequence

import trio

from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.receive_budget import ReceiveBudget
from strands_actors.drivers.common.udp_port import UdpListener
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
"""Datagrams that are taken at once: a flood does not keep an answer waiting for longer. The system
keeps no more for a socket."""
MOST_READ = 64
"""Of those, the newest that are decoded: a message takes 0.1 ms."""
STANDING_RAD_S = 0.02
STAND_S = 0.03
"""Positions so far apart tell whether the arm stands."""
ALONE_STAND_S = 0.1
"""As that, of an arm that does not follow our answers [assumed]: a joint that nothing holds begins
to fall from a stand, and its first hundredths of a second look like one."""
HEAR_S = 0.3
"""A controller that says nothing for so long is not there."""
CONFIRM_S = 0.8
"""By then an arm that was at full speed has come to a stand [?]."""
QUIET_CYCLES = 2.5
"""Without a message for so many cycles a hold is sent unasked."""


class Link:
    """``port``: it has met the controller, who said ``said``."""

    def __init__(self, port: UdpListener, arm: Arm, clock: Clock, said: Monitoring) -> None:
        self.port = port
        self.session = FriSession(arm.speed_rad_s)
        self.session.hear(said)
        self.said = said
        self.heard_ns = self._written_ns = clock.now_ns()
        self.answers = 0
        self.news = trio.Event()  # set, and replaced, with each message that was understood
        self._clock = clock
        self._arm = arm
        self._seen: deque[tuple[int, tuple[float, ...]]] = deque()  # positions of ALONE_STAND_S, and one before
        self._inbox = Inbox(port)

    async def hear(self) -> Monitoring:
        """Return the newest message, once there is one that is understood, and news. Raise
        ``WireDown``."""
        while True:
            # Noise and what was said before are no message: silence is judged by the last that was one.
            news = [said for said in self._inbox.messages(await self.port.read()) if self.session.hear(said)]
            if news:
                self._take(news[-1])
                return news[-1]

    def _take(self, said: Monitoring) -> None:
        if (said.sequence - self.said.sequence) & COUNTER > LATE:
            self._seen.clear()  # a stand is seen in messages that follow each other
        self.said, self.heard_ns = said, self._clock.now_ns()
        self._seen.append((self.heard_ns, said.position))
        while len(self._seen) > 2 and self.heard_ns - self._seen[1][0] >= ALONE_STAND_S * NS:
            self._seen.popleft()
        self.news.set()
        self.news = trio.Event()

    def answer(self, said: Monitoring) -> None:
        """Answer a message, if it is one that wants it. Raise ``WireDown``."""
        if self.session.is_due(said):
            self._write(self.session.answer(said))
            self.answers += 1

    def _write(self, command: Command) -> None:
        self.port.write(encode_command(command))
        self._written_ns = self._clock.now_ns()

    @property
    def state(self) -> str:
        """Return the name of the session's state."""
        return name_of(State, self.said.state)

    def silent_s(self) -> float:
        """Return for how long no message was understood."""
        return (self._clock.now_ns() - self.heard_ns) / NS

    # -- to a stand

    async def bring_to_stand(self, cycle: Callable[[], Awaitable[None]], detail: str) -> tuple[MotorReport, ...]:
        """Look until answers that hold have left and the arm stands; where it is our answers that
        hold it, until the controller has taken one of them, too. ``cycle`` returns when the next
        message has been answered; it raises ``WireDown``. Never raises."""
        first, hold, failure = self.answers, self.session.next_number(self.said), ""
        quiet_s = QUIET_CYCLES * cycle_s(self.said)
        written = False
        self._seen.clear()
        try:
            with trio.move_on_after(CONFIRM_S):
                while not self._is_held(first, hold):
                    # Nothing wants an answer: a controller that is not heard may hear. One datagram
                    # may be lost, so it is told again and again.
                    if self._clock.now_ns() - self._written_ns >= round(quiet_s * NS):
                        written = self.hold_unasked()
                    with trio.move_on_after(quiet_s):
                        await cycle()
        except WireDown as down:
            failure = str(down)
        written = written or self.answers > first
        return self.reports(written, self._is_taken(hold), self._is_held(first, hold), failure or detail)

    def hold_unasked(self) -> bool:
        """Hold in answer to an old message: who is not heard may hear. True. Raise ``WireDown``."""
        self._write(self.session.again(self.said))
        return True

    @property
    def _follows_us(self) -> bool:
        """Whether it is our answers that the arm does: else they neither move nor hold it."""
        return self.said.state == State.COMMANDING_ACTIVE

    def _is_held(self, first: int, hold: int) -> bool:
        """Tell whether two answers have left since, the arm is measured to stand, and, where it
        follows us, the controller has taken the answer ``hold`` or one behind it: one that was
        only sent may be lost on the way, and the arm stand at the end of a step."""
        if self.answers - first < 2 or not self._stands():
            return False
        return self._is_taken(hold) or not self._follows_us

    def _is_taken(self, hold: int) -> bool:
        """Tell whether the controller says that it has an answer that holds."""
        return self.session.has_taken(self.said, hold)

    def _stands(self) -> bool:
        """Tell whether the measured positions of the newest messages are alike. In no state of the
        session is that taken for granted: what the robot does in a stop of its own, with its drives
        off, is not known."""
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
        """Return what became of every joint."""
        alone = f"FRI session is {self.state}" if self.said.state < State.COMMANDING_WAIT else ""
        if held and alone:
            detail = f"{alone}: {self._holder()}"
        elif not held and not detail:
            detail = self._why_not_held(taken, alone)
        return _reports(self._arm, written, taken, held, detail, self.session.commanded)

    def _holder(self) -> str:
        """Return who holds an arm that stands and does not follow us, as far as it tells."""
        said = self.said
        if said.safety or any(drive != Drive.ACTIVE for drive in said.drives):
            return "it stands, in a stop of the robot's own"
        return "the robot's own program holds it"

    def _why_not_held(self, taken: bool, alone: str) -> str:
        if self.silent_s() > STAND_S:
            return f"no FRI message for {self.silent_s() * 1e3:.0f} ms"
        if not self._stands():
            return f"{alone}, and it still moves" if alone else "it still moves"
        if self._follows_us and not taken:
            return "the controller has taken none of our answers"
        return "it asks for no answers"


def cycle_s(said: Monitoring) -> float:
    """Return the time from one answer to the next."""
    return said.sample_ms * said.multiplier / 1e3


async def answer_instead(
    port: UdpListener, arm: Arm, clock: Clock, at_least_s: float, detail: str
) -> tuple[MotorReport, ...] | None:
    """Answer in place of whoever did so before, until the arm stands: with the last commanded
    position, as the controller has it. Sequence numbers go on from what it says. None: it says
    nothing. Raise ``WireDown``."""
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
    """Report that no joint is confirmed."""
    return _reports(arm, written, False, False, why)


def _reports(
    arm: Arm, written: bool, taken: bool, held: bool, detail: str, target: Sequence[float] = ()
) -> tuple[MotorReport, ...]:
    """Report the same of every joint: one answer is for all."""
    return tuple(
        MotorReport(axis, at + 1, written, taken, held, detail, target[at] if held and target else None)
        for at, axis in enumerate(arm.axes)
    )


async def first_message(port: UdpListener) -> Monitoring:
    """Return the newest message of the first controller that speaks. Raise ``WireDown``."""
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
    """What waits at a port."""

    def __init__(self, port: UdpListener) -> None:
        self._port = port
        self._budget = ReceiveBudget("the FRI session", MOST_WAITING, MOST_WAITING * LARGEST)

    def messages(self, first: bytes) -> Iterator[Monitoring]:
        """Return ``first`` and what waits behind it, as far as it is understood. Raise ``WireDown``
        for a peer that cannot be followed."""
        waiting = [first, *self._budget.turn(self._port.read_waiting)]
        return filter(None, map(understood, waiting[-MOST_READ:]))


def understood(data: bytes) -> Monitoring | None:
    try:
        return decode_monitoring(data)
    except MalformedFrame:
        return None
