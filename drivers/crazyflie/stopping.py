"""How a Crazyflie is brought down: the safe states that end a flight, for the wire and for the
root's stop channel.

``land``  the high-level commander takes it down, 0.4 m/s in the mean; motors off on the floor
``limp``  motors off at once, wherever it is
``off``   motors off at once, and locked until it is switched off and on
"""

from __future__ import annotations

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import ProcessSpent, WireDown
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.outcome import Outcome

from . import protocol as p
from .config import LANDING_M_S
from .protocol import Bit
from .session import CrazyflieSession

ANSWER_S = 1.0
"""Within which a question must be answered; it is asked again several times meanwhile."""
YIELD_S = 0.3
"""So long the answer to an order to land is waited for before it is told to yield."""
LANDING_LOOK_S = 0.5
"""Within which the supervisor must answer during a landing, before it is told to yield once more."""
LOOK_S = 0.1
"""Between two looks at the supervisor."""
STOP_S = 9.0
"""Longest that bringing it down may take: landing from 2 m (5 s), the two seconds for which it may
count as flying afterwards, and packets that are lost. Less than ``Timing.safe_s``, and than what is
left of it when a link is reached."""
NOTICED_S = 0.1
"""The supervisor looks 25 times a second: what it says sooner may be from before an order."""
FLOOR_M = 0.1
"""At this height or below a landing that is over has ended on the floor: an estimate is not better, and
from here a drone may fall."""
FRESH_S = 0.5
"""A height that is older counts as none."""


async def bring_down(
    session: CrazyflieSession, safe_state: SafeState, within_s: float = STOP_S, land_s: float | None = None
) -> Outcome:
    """Bring it to a safe state that ends its flight, and look that it is. ``land_s``: how long a
    landing takes; None: as long as the height needs, which the drone knows. Never raises; the first
    frame leaves before the first wait. A link that is lost, and may not carry anything again, is not
    tried any longer: whoever asks opens another."""
    descent = _Descent(session, safe_state, land_s)
    detail = "silent"
    with trio.move_on_after(within_s):
        while True:
            try:
                detail = await descent.step()
                if not detail:
                    return Outcome(True, True, "")
            except (WireDown, ProcessSpent) as failure:
                detail = str(failure)
                if not session.link.outlives_a_loss:
                    break
            await trio.sleep(LOOK_S)
    return Outcome(descent.written, descent.acknowledged, detail)


def first_frames(safe_state: SafeState) -> tuple[bytes, ...]:
    """Return what begins to bring it there, for a link that may carry nothing any more."""
    match safe_state:
        case SafeState.OFF:
            return p.STOP, p.EMERGENCY_STOP
        case SafeState.LAND:
            # In this order: who yields to a high-level commander without a plan has its motors cut.
            return p.land_with_velocity(LANDING_M_S), p.YIELD
    return (p.STOP,)


class _Descent:
    """One order to come down, however often it has to be said."""

    def __init__(self, session: CrazyflieSession, safe_state: SafeState, land_s: float | None) -> None:
        self._session = session
        self._safe_state = safe_state
        self._order = p.land_with_velocity(LANDING_M_S) if land_s is None else p.land(land_s)
        self._taken_s: float | None = None  # when the robot said that it lands
        self._refused = False
        self.written = False
        self.acknowledged = False

    async def step(self) -> str:
        """Say it, and look. Return why it is not safe yet; empty: it is. Raise ``WireDown``."""
        return await self._say_and_look() or self._contradicted()

    def _contradicted(self) -> str:
        """Return what its log says against an answer that it is safe; empty: nothing, or there is no
        log. An answer has no number, so it may be one to an older question. A row of the log has the
        time of the robot."""
        session = self._session
        if session.repeats():
            return "its log stands still"
        flight = session.flight
        if flight is not None and session.age_s() <= FRESH_S and flight.bits.airborne:
            return "its log shows it in the air"
        return ""

    async def _say_and_look(self) -> str:
        match self._safe_state:
            case SafeState.OFF:
                return await self._lock()
            case SafeState.LAND:
                return await self._land()
        return await self._cut()

    async def _lock(self) -> str:
        await self._say(*first_frames(SafeState.OFF))
        bits = await self._look()
        if bits is None:
            return "silent"
        return "" if Bit.LOCKED in bits else "it is not locked"

    async def _cut(self) -> str:
        await self._say(p.STOP)
        return await self._disarm()

    async def _land(self) -> str:
        """The trajectory's end counts only after the robot has taken this order: before, it may be
        another's. Motors are cut on the floor only: the robot itself switches them off where the
        trajectory ends."""
        if self._taken_s is None:
            await self._tell_to_land()
        bits = await self._look(LANDING_LOOK_S)
        if bits is None:
            if self._taken_s is not None:
                await self._say(p.YIELD)
            return "silent"
        if not bits.airborne or bits & (Bit.TUMBLED | Bit.LOCKED | Bit.CRASHED):
            return await self._cut()
        flies = Bit.HIGH_LEVEL_ACTIVE in bits
        if self._refused and flies and self._taken_s is None:
            self._take()  # who is landing already refuses to begin anew
        if self._taken_s is None:
            return self._unlanded()
        if flies:
            await self._say(p.YIELD)  # the one before may be lost: then the last setpoint still has it
        if trio.current_time() - self._taken_s < NOTICED_S:
            return self._unlanded() if self._refused else "still in the air"
        over = Bit.TRAJECTORY_FINISHED in bits and Bit.HIGH_LEVEL_DISABLED not in bits
        if over and self._is_down():
            return await self._cut()
        if flies == over:
            # No landing is flown, and none has ended: a setpoint that came late was obeyed instead, or
            # it hovers by an order of before.
            self._taken_s = None
            return self._unlanded()
        return "still in the air"

    async def _tell_to_land(self) -> None:
        """Tell it to land, and to yield once it has answered: a high-level commander that has no plan
        cuts the motors when it is yielded to. Nor much later: its plan goes on while the last setpoint
        is obeyed. Who does not answer may have heard us: it is told to yield, too, and the order right
        after that, which mends what the first one may have broken."""
        question = p.landing_question(self._order)
        answer = await self._session.ask(question, YIELD_S)
        self.written = True
        if answer is None:
            await self._say(p.YIELD)
            answer = await self._session.ask(question, ANSWER_S)
        try:
            status = None if answer is None else p.landing_status_of(answer)
        except MalformedFrame:
            status = None
        self._refused = bool(status)
        if status == 0:
            self._take()
            await self._say(p.YIELD, p.YIELD)  # nobody answers it

    def _unlanded(self) -> str:
        return "it refuses to land" if self._refused else "it does not land"

    def _take(self) -> None:
        self._taken_s = trio.current_time()
        self.acknowledged = True

    def _is_down(self) -> bool:
        flight = self._session.flight
        return flight is not None and self._session.age_s() <= FRESH_S and flight.z_m <= FLOOR_M

    async def _disarm(self) -> str:
        """A robot that is not armed has no motors. One that arms by itself counts as flying for a
        while."""
        answer = await self._session.ask(p.DISARM_QUESTION, ANSWER_S)
        try:
            if answer is not None and not p.is_armed(answer):
                self.acknowledged = True
                return ""
        except MalformedFrame:
            return "what it answers is damaged"
        bits = await self._look()
        if bits is None:
            return "silent"
        return "its motors are not off" if bits.airborne else ""

    async def _say(self, *packets: bytes) -> None:
        await self._session.say(*packets)
        self.written = True

    async def _look(self, within_s: float = ANSWER_S) -> Bit | None:
        bits = await self._session.supervisor(within_s)
        self.acknowledged = self.acknowledged or bits is not None
        return bits
