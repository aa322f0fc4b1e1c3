"""Questions and readings over one link that may lose what it carries: what is not answered is asked
again, until a deadline."""

from __future__ import annotations

import math
from collections.abc import Sequence

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.receive_budget import ReceiveBudget
from strands_actors.drivers.common.stamps import Stamps
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from .links import Link

AGAIN_S = 0.25
"""After which a question that was not answered is asked again."""
SHORTEST_S = 0.001
"""Of a wait: what is left of ``AGAIN_S`` may be less than a clock can show."""
WINDOW = 8
"""Questions that are asked at once."""


class CrazyflieSession:
    """``flight`` and ``position`` are the newest readings. A row that came before, or is older than the
    newest by the robot's own clock, is none."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self.link = link
        self._budget = ReceiveBudget(link.name)
        self._clock = clock
        self.flight: p.Flight | None = None
        self.position: p.Position | None = None
        self._flights, self._positions = Stamps(p.STAMP_WRAP_MS), Stamps(p.STAMP_WRAP_MS)
        self.malformed = 0
        self._waiting: list[dict[p.Question, bytes | None]] = []  # one for each who asks
        self._served = False
        self._news = trio.Event()

    # -- hearing

    @property
    def flight_ns(self) -> int:
        """Return when ``flight`` came; 0: none has."""
        return self._flights.new_ns

    @property
    def position_ns(self) -> int:
        """Return when ``position`` came; 0: none has."""
        return self._positions.new_ns

    @property
    def robot_s(self) -> float:
        """Return when ``flight`` was measured, by the robot's own clock, counted from the first one."""
        return self._flights.passed / 1e3

    @property
    def goes_on(self) -> bool:
        """Return whether both were seen to change: a first one may be the last of a log that is stuck."""
        return self._flights.goes_on and self._positions.goes_on

    async def serve(self) -> None:
        """Hear whatever comes, until cancelled. Raise ``WireDown``."""
        self._served = True
        try:
            async with trio.open_nursery() as nursery:
                await nursery.start(self.link.serve)
                while True:
                    self._take(await self.link.read())
        finally:
            self._served = False

    def take_waiting(self) -> None:
        """Take in what has arrived, as much as one turn may take. Never waits."""
        for packet in self._budget.turn(self.link.read_waiting):
            self._take(packet)

    async def news(self, within_s: float) -> None:
        """Wait for a packet, at most so long."""
        with trio.move_on_after(within_s):
            if self._served:
                await self._news.wait()
            else:
                self._take(await self.link.read())

    def age_s(self) -> float:
        """Return how old ``flight`` is."""
        return (self._clock.now_ns() - self.flight_ns) / NS if self.flight_ns else math.inf

    def repeats(self) -> bool:
        """Return whether rows come, and tell nothing new of its flight."""
        return self._flights.repeats(self._clock.now_ns())

    def _take(self, packet: bytes) -> None:
        self._news.set()
        self._news = trio.Event()
        try:
            row = p.row_of(packet)
        except MalformedFrame:
            self.malformed += 1
            return
        if row is not None:
            self._note(*row)
            return
        for answers in self._waiting:
            for question, answer in answers.items():
                if answer is None and question.answered_by(packet):
                    answers[question] = packet

    def _note(self, stamp_ms: int, reading: p.Flight | p.Position) -> None:
        now_ns = self._clock.now_ns()
        if isinstance(reading, p.Flight):
            if self._flights.take(stamp_ms, now_ns):
                self.flight = reading
        elif self._positions.take(stamp_ms, now_ns):
            self.position = reading

    # -- asking

    async def say(self, *packets: bytes) -> None:
        """Send packets that nobody answers. Raise ``WireDown``."""
        for packet in packets:
            await self.link.write(packet)

    async def ask(self, question: p.Question, within_s: float, permit: Permit | None = None) -> bytes | None:
        """Return the answer, None when there is none in time."""
        return (await self.ask_all((question,), within_s, permit))[0]

    async def ask_all(
        self, questions: Sequence[p.Question], within_s: float, permit: Permit | None = None
    ) -> list[bytes | None]:
        """Return the answers, None for each that did not come in time. Who asks what another is
        asking already has the same answer. Raise ``WireDown``."""
        answers: dict[p.Question, bytes | None] = dict.fromkeys(questions)
        self._waiting.append(answers)
        asked_s: dict[p.Question, float] = {}
        try:
            with trio.move_on_after(within_s):
                while missing := [question for question in questions if answers[question] is None][:WINDOW]:
                    now_s = trio.current_time()
                    for question in missing:
                        if now_s - asked_s.get(question, -math.inf) >= AGAIN_S:
                            asked_s[question] = now_s
                            await self.link.write(question.packet, permit)
                    due_s = min(asked_s[question] for question in missing) + AGAIN_S - now_s
                    await self.news(max(SHORTEST_S, due_s))
            return [answers[question] for question in questions]
        finally:
            # By identity: two who ask the same are equal until one of them has its answer.
            self._waiting = [other for other in self._waiting if other is not answers]

    async def supervisor(self, within_s: float) -> p.Bit | None:
        """Return what the supervisor says now, None when it does not. Raise ``WireDown``."""
        answer = await self.ask(p.SUPERVISOR_QUESTION, within_s)
        try:
            return None if answer is None else p.supervisor_of(answer)
        except MalformedFrame:
            return None


HANDSHAKE_S = 3.0
"""Within which a first answer must come."""
TABLE_S = 10.0
"""Within which the table of log variables must be read, some hundred rows of it."""


async def handshake(session: CrazyflieSession, period_s: float) -> dict[str, object]:
    """Ask who it is, and for rows of the log: flight every ``period_s``, position ten times a second.
    Moves nothing. Return facts for status. Raise ``WireDown``."""
    name = session.link.name
    try:
        told = await session.ask(p.VERSION_QUESTION, HANDSHAKE_S)
        if told is None:
            raise WireDown(f"{name}: no answer within {HANDSHAKE_S:g} s. Check port=, radio and power")
        version = p.version_of(told)
        if version < p.OLDEST:
            raise WireDown(
                f"{name}: its firmware speaks CRTP protocol {version}; from {p.OLDEST} on a landing can be "
                "confirmed. Update the firmware"
            )
        firmware = await session.ask(p.FIRMWARE_QUESTION, HANDSHAKE_S)
        rows = await _start_log(session, name, period_s)
    except MalformedFrame as malformed:
        raise WireDown(f"{name}: {malformed}. Is it a Crazyflie?") from None
    with trio.move_on_after(HANDSHAKE_S):
        while not session.goes_on:
            await session.news(HANDSHAKE_S)
        return {
            "address": name,
            "firmware": p.firmware_of(firmware) if firmware else "",
            "crtp_protocol": version,
            "log_variables": rows,
        }
    raise WireDown(f"{name}: its log does not come. Switch it off and on")


async def _start_log(session: CrazyflieSession, name: str, period_s: float) -> int:
    """Return how many variables there are. Raise ``WireDown`` and ``MalformedFrame``."""
    await _must(session, name, p.LOG_RESET_QUESTION)
    count = p.log_count_of(await _must(session, name, p.LOG_INFO_QUESTION))
    items = await session.ask_all([p.log_item_question(at) for at in range(count)], TABLE_S)
    number_of = {p.log_name_of(item): at for at, item in enumerate(items) if item is not None}
    for block, every_s in ((p.FLIGHT, period_s), (p.POSITION, POSITION_S)):
        missing = [variable for variable, _ in block.variables if variable not in number_of]
        if missing:
            raise WireDown(f"{name}: its log has no {', '.join(missing)}. Update the firmware")
        numbers = [number_of[variable] for variable, _ in block.variables]
        for question in (p.log_create_question(block, numbers), p.log_start_question(block, every_s)):
            status = p.status_of(await _must(session, name, question))
            if status not in (0, p.EXISTS):
                raise WireDown(f"{name}: refuses a block of the log (error {status}). Switch it off and on")
    return count


POSITION_S = 0.1


async def _must(session: CrazyflieSession, name: str, question: p.Question) -> bytes:
    answer = await session.ask(question, HANDSHAKE_S)
    if answer is None:
        raise WireDown(f"{name}: no answer within {HANDSHAKE_S:g} s. Check radio and power")
    return answer
