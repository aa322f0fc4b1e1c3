"""Bring a Crazyflie to a safe state that ends its flight. The wire and the root's stop channel use this.

``land``  the high-level commander lands it, at 0.4 m/s in the mean; motors off on the floor
``limp``  motors off at once, in any place
``off``   motors off at once, and locked until it is switched off and on
"""

from __future__ import annotations

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import ProcessSpent, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import Outcome

from . import protocol as p
from .config import LANDING_M_S
from .protocol import Bit
from .session import CrazyflieSession

ANSWER_S = 1.0
"""Longest time for an answer. The request is repeated several times meanwhile."""
YIELD_S = 0.3
"""How long the answer to an order to land is waited for before ``YIELD`` is sent."""
LANDING_LOOK_S = 0.5
"""Longest time for an answer of the supervisor during a landing, before ``YIELD`` is sent again."""
LOOK_S = 0.1
"""Period of reading the supervisor."""
STOP_S = 9.0
"""Longest duration of a stop: a landing from 2 m (5 s), two seconds for which the drone may count as flying
afterwards, and lost packets. This is less than ``Timing.safe_s``, and less than the rest of it when a new link has
to be opened first."""
NOTICED_S = 0.1
"""The supervisor runs 25 times a second. A report within this time may be from before an order."""
FLOOR_M = 0.1
"""A landing that has ended at this height or below has ended on the floor. The estimate is not more precise, and a
drone may fall from here."""
FRESH_S = 0.5
"""Age up to which a height counts."""


async def bring_down(
    session: CrazyflieSession, safe_state: SafeState, within_s: float = STOP_S, land_s: float | None = None
) -> Outcome:
    """Bring the drone to a safe state that ends its flight, and read back that it is in it.

    Never raises. The first frame leaves before the first wait. If the link is lost and has a connection that may be
    dead, the attempt ends, and the caller opens another link.

    Args:
        session: A session with the drone.
        safe_state: ``land``, ``limp`` or ``off``.
        within_s: Longest duration, seconds.
        land_s: Duration of a landing; None for the time that the height needs, which the drone knows.
    """
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
    """Return the frames that begin a safe state, for a link that may be dead."""
    match safe_state:
        case SafeState.OFF:
            return p.STOP, p.EMERGENCY_STOP
        case SafeState.LAND:
            # The order matters: ``YIELD`` to a high-level commander without a plan cuts the motors.
            return p.land_with_velocity(LANDING_M_S), p.YIELD
    return (p.STOP,)


class _Descent:
    """One descent, with all repetitions of its order."""

    def __init__(self, session: CrazyflieSession, safe_state: SafeState, land_s: float | None) -> None:
        self._session = session
        self._safe_state = safe_state
        self._order = p.land_with_velocity(LANDING_M_S) if land_s is None else p.land(land_s)
        self._taken_s: float | None = None  # when the robot accepted the order to land
        self._refused = False
        self.written = False
        self.acknowledged = False

    async def step(self) -> str:
        """Send the order and read the state. Return why the drone is not safe yet; empty if it is. Raise
        ``WireDown``."""
        return await self._say_and_look() or self._contradicted()

    def _contradicted(self) -> str:
        """Return how the log contradicts an answer that the drone is safe; empty if it does not, or if there
        is no log.

        Answers have no number, so one may belong to an older request. A row of the log has the robot's time.
        """
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
        """Land, then cut the motors on the floor.

        The end of the trajectory counts only after the robot has accepted this order, since an earlier end may be
        that of another order. The robot itself switches the motors off where the trajectory ends.
        """
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
            self._take()  # A landing drone refuses a new order to land.
        if self._taken_s is None:
            return self._unlanded()
        if flies:
            await self._say(p.YIELD)  # If the last YIELD was lost, the last setpoint is still in force.
        if trio.current_time() - self._taken_s < NOTICED_S:
            return self._unlanded() if self._refused else "still in the air"
        over = Bit.TRAJECTORY_FINISHED in bits and Bit.HIGH_LEVEL_DISABLED not in bits
        if over and self._is_down():
            return await self._cut()
        if flies == over:
            # No landing is flown, and none has ended. A late setpoint was obeyed instead, or the drone hovers by an
            # earlier order.
            self._taken_s = None
            return self._unlanded()
        return "still in the air"

    async def _tell_to_land(self) -> None:
        """Send the order to land, then ``YIELD`` once it is answered.

        ``YIELD`` to a high-level commander without a plan cuts the motors, so it must not come earlier. It must
        not come much later, either, because the plan advances while the last setpoint is obeyed. A drone that
        does not answer may have received the order. It gets ``YIELD``, too, and right after that the order again,
        which repairs a ``YIELD`` without a plan.
        """
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
            await self._say(p.YIELD, p.YIELD)  # twice, since it has no answer

    def _unlanded(self) -> str:
        return "it refuses to land" if self._refused else "it does not land"

    def _take(self) -> None:
        self._taken_s = trio.current_time()
        self.acknowledged = True

    def _is_down(self) -> bool:
        flight = self._session.flight
        return flight is not None and self._session.age_s() <= FRESH_S and flight.z_m <= FLOOR_M

    async def _disarm(self) -> str:
        """Disarm the drone, which switches its motors off. A drone that arms by itself counts as flying for a
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
