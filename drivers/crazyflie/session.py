"""Requests to the drone, and its reports, over a link that may lose packets. A request is repeated until it is
answered or its deadline passes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.stamps import Stamps
from strands_actors.drivers.common.ports.receive_budget import ReceiveBudget
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from .links import Link

AGAIN_S = 0.25
"""Pause before an unanswered request is repeated."""
SHORTEST_S = 0.001
"""Shortest wait, because the rest of ``AGAIN_S`` may be less than the clock's resolution."""
WINDOW = 8
"""Number of requests in flight at once."""


class CrazyflieSession:
    """Requests to the drone and its reports, over one link. ``flight`` and ``position`` are the newest reports.
    A report that repeats the previous time, or is older by the drone's clock, is dropped."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self.link = link
        self._budget = ReceiveBudget(link.name)
        self._clock = clock
        self.flight: p.Flight | None = None
        self.position: p.Position | None = None
        self._flights, self._positions = Stamps(p.STAMP_WRAP_MS), Stamps(p.STAMP_WRAP_MS)
        self.malformed = 0
        # One table of requests and answers for each waiting caller.
        self._waiting: list[dict[p.Question, bytes | None]] = []
        self._served = False
        self._news = trio.Event()

    # -- receiving

    @property
    def flight_ns(self) -> int:
        """Return when the newest ``flight`` arrived, ns; 0 before the first."""
        return self._flights.new_ns

    @property
    def position_ns(self) -> int:
        """Return when the newest ``position`` arrived, ns; 0 before the first."""
        return self._positions.new_ns

    @property
    def robot_s(self) -> float:
        """Return the time at which ``flight`` was measured, in seconds since the first report, by the drone's
        clock."""
        return self._flights.passed / 1e3

    @property
    def goes_on(self) -> bool:
        """Return True if both reports have changed since this session began. A single report may be the last one
        of a log that hangs."""
        return self._flights.goes_on and self._positions.goes_on

    async def serve(self) -> None:
        """Receive packets until cancelled. Raise ``WireDown``."""
        self._served = True
        try:
            async with trio.open_nursery() as nursery:
                await nursery.start(self.link.serve)
                while True:
                    self._take(await self.link.read())
        finally:
            self._served = False

    def take_waiting(self) -> None:
        """Process the packets that have arrived, up to the limit for one call. Never waits."""
        for packet in self._budget.turn(self.link.read_waiting):
            self._take(packet)

    async def news(self, within_s: float) -> None:
        """Wait until the next packet is processed, for at most ``within_s`` seconds."""
        with trio.move_on_after(within_s):
            if self._served:
                await self._news.wait()
            else:
                self._take(await self.link.read())

    def age_s(self) -> float:
        """Return the age of ``flight`` in seconds; infinite if there is no reading."""
        return (self._clock.now_ns() - self.flight_ns) / NS if self.flight_ns else math.inf

    def repeats(self) -> bool:
        """Return True if reports still arrive, but with the same time and content."""
        return self._flights.repeats(self._clock.now_ns())

    def _take(self, packet: bytes) -> None:
        self._news.set()
        self._news = trio.Event()
        try:
            report = p.report_of(packet)
        except MalformedFrame:
            self.malformed += 1
            return
        if report is not None:
            self._note(*report)
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

    # -- sending

    async def send(self, *packets: bytes) -> None:
        """Send packets to which the drone gives no answer. Raise ``WireDown``."""
        for packet in packets:
            await self.link.write(packet)

    async def ask(self, question: p.Question, within_s: float, permit: Permit | None = None) -> bytes | None:
        """Send a request. Return its answer; None if it did not come in time. Raise ``WireDown``."""
        return (await self.ask_all((question,), within_s, permit))[0]

    async def ask_all(
        self, questions: Sequence[p.Question], within_s: float, permit: Permit | None = None
    ) -> list[bytes | None]:
        """Send requests. Return their answers, with None for each that did not come in time. Callers with the same
        pending request share its answer. Raise ``WireDown``."""
        answers: dict[p.Question, bytes | None] = dict.fromkeys(questions)
        self._waiting.append(answers)
        sent_s: dict[p.Question, float] = {}
        try:
            with trio.move_on_after(within_s):
                while missing := [question for question in questions if answers[question] is None][:WINDOW]:
                    now_s = trio.current_time()
                    for question in missing:
                        if now_s - sent_s.get(question, -math.inf) >= AGAIN_S:
                            sent_s[question] = now_s
                            await self.link.write(question.packet, permit)
                    due_s = min(sent_s[question] for question in missing) + AGAIN_S - now_s
                    await self.news(max(SHORTEST_S, due_s))
            return [answers[question] for question in questions]
        finally:
            # Compare by identity. Two callers with the same request have equal entries until one is answered.
            self._waiting = [entry for entry in self._waiting if entry is not answers]

    async def supervisor(self, within_s: float) -> p.Bit | None:
        """Return the supervisor's present flags; None if it does not answer. Raise ``WireDown``."""
        answer = await self.ask(p.SUPERVISOR_QUESTION, within_s)
        try:
            return None if answer is None else p.supervisor_of(answer)
        except MalformedFrame:
            return None


HANDSHAKE_S = 3.0
"""Longest time for each answer of the handshake."""
TABLE_S = 10.0
"""Longest time to read the table of log variables, some hundred of them."""


async def handshake(session: CrazyflieSession, period_s: float) -> dict[str, object]:
    """Identify the drone, and start its log: a flight report every ``period_s``, a position report ten times a
    second. Nothing moves. Return facts about the drone, which the verb ``status`` shows. Raise ``WireDown``."""
    name = session.link.name
    try:
        answer = await session.ask(p.VERSION_QUESTION, HANDSHAKE_S)
        if answer is None:
            raise WireDown(f"{name}: no answer within {HANDSHAKE_S:g} s. Check port=, radio and power")
        version = p.version_of(answer)
        if version < p.OLDEST:
            raise WireDown(
                f"{name}: its firmware speaks CRTP protocol {version}. A landing can be confirmed only "
                f"from {p.OLDEST} on. Update the firmware"
            )
        firmware = await session.ask(p.FIRMWARE_QUESTION, HANDSHAKE_S)
        variables = await _start_log(session, name, period_s)
    except MalformedFrame as malformed:
        raise WireDown(f"{name}: {malformed}. Is it a Crazyflie?") from None
    with trio.move_on_after(HANDSHAKE_S):
        while not session.goes_on:
            await session.news(HANDSHAKE_S)
        return {
            "address": name,
            "firmware": p.firmware_of(firmware) if firmware else "",
            "crtp_protocol": version,
            "log_variables": variables,
        }
    raise WireDown(f"{name}: no log data arrives. Switch the drone off and on")


async def _start_log(session: CrazyflieSession, name: str, period_s: float) -> int:
    """Start the two log blocks. Return the number of variables that the drone can log. Raise ``WireDown`` and
    ``MalformedFrame``."""
    await _must(session, name, p.LOG_RESET_QUESTION)
    count = p.log_count_of(await _must(session, name, p.LOG_INFO_QUESTION))
    items = await session.ask_all([p.log_item_question(number) for number in range(count)], TABLE_S)
    number_of = {p.log_name_of(item): number for number, item in enumerate(items) if item is not None}
    for block, every_s in ((p.FLIGHT, period_s), (p.POSITION, POSITION_S)):
        missing = [variable for variable, _ in block.variables if variable not in number_of]
        if missing:
            raise WireDown(f"{name}: its log has no {', '.join(missing)}. Update the firmware")
        numbers = [number_of[variable] for variable, _ in block.variables]
        for question in (p.log_create_question(block, numbers), p.log_start_question(block, every_s)):
            status = p.status_of(await _must(session, name, question))
            if status not in (0, p.EXISTS):
                raise WireDown(f"{name}: the drone refuses a log block (error {status}). Switch it off and on")
    return count


POSITION_S = 0.1


async def _must(session: CrazyflieSession, name: str, question: p.Question) -> bytes:
    answer = await session.ask(question, HANDSHAKE_S)
    if answer is None:
        raise WireDown(f"{name}: no answer within {HANDSHAKE_S:g} s. Check radio and power")
    return answer
