"""How a Crazyflie is brought down: the safe states that end a flight, for the wire and for the
root's stop channel.

``land``  the high-level commander takes it down in 2 s; motors off when it says that it is down
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
from .config import LAND_S
from .protocol import Bit
from .session import Session

ANSWER_S = 1.0
"""Within which a question must be answered; it is asked again several times meanwhile."""
LOOK_S = 0.1
"""Between two looks at the supervisor."""
STOP_S = 5.5
"""Longest that bringing it down may take: landing, the two seconds for which it may count as flying
afterwards, and packets that are lost. Less than ``Timing.safe_s``, and than what is left of it when
a link is reached."""


async def bring_down(
    session: Session, safe_state: str, within_s: float = STOP_S, land_s: float = LAND_S
) -> Outcome:
    """Bring it to a safe state that ends its flight, and look that it is. Never raises; the first
    frame leaves before the first wait."""
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
            await trio.sleep(LOOK_S)
    return Outcome(descent.written, descent.acknowledged, detail)


def first_frames(safe_state: str, land_s: float = LAND_S) -> tuple[bytes, ...]:
    """Return what begins to bring it there, for a link that may carry nothing any more."""
    match safe_state:
        case SafeState.OFF:
            return p.STOP, p.EMERGENCY_STOP
        case SafeState.LAND:
            return p.YIELD, p.land(land_s)
    return (p.STOP,)


class _Descent:
    """One order to come down, however often it has to be said."""

    def __init__(self, session: Session, safe_state: str, land_s: float) -> None:
        self._session = session
        self._safe_state = safe_state
        self._land_s = land_s
        self._taken_s: float | None = None  # when the robot said that it lands
        self.written = False
        self.acknowledged = False

    async def step(self) -> str:
        """Say it, and look. Return why it is not safe yet; empty: it is. Raise ``WireDown``."""
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
        another's."""
        session = self._session
        if self._taken_s is None:
            await self._say(p.YIELD)
            if await session.ask(p.land_question(self._land_s), ANSWER_S) is not None:
                self._taken_s = trio.current_time()
        bits = await self._look()
        if bits is None:
            return "silent"
        if not bits.airborne or bits & (Bit.TUMBLED | Bit.LOCKED | Bit.CRASHED):
            return await self._cut()
        passed_s = -1.0 if self._taken_s is None else trio.current_time() - self._taken_s
        if passed_s >= self._land_s and Bit.TRAJECTORY_FINISHED in bits:
            return await self._cut()
        if Bit.HIGH_LEVEL_ACTIVE not in bits:
            await self._say(p.YIELD)  # the one before was lost: the last setpoint still has it
        return "it does not land" if self._taken_s is None else "still in the air"

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

    async def _look(self) -> Bit | None:
        bits = await self._session.supervisor(ANSWER_S)
        self.acknowledged = self.acknowledged or bits is not None
        return bits
