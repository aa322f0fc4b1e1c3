"""Bring a Crazyflie to a safe state that ends its flight. The process that flies it and the supervising process
(root) use this code.

``land``  the high-level commander lands it, at 0.4 m/s on average; motors off on the floor
``limp``  motors off at once, in any place
``off``   motors off at once, and locked until it is switched off and on
"""

from __future__ import annotations

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.kit.stop_steps import repeat_until_safe

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
    """Bring the drone to a safe state that ends its flight, and check that it has reached that state.

    Never raises. The first packet is sent before anything is waited for. If a link with a connection is lost, the
    attempt ends, because that connection may be dead. The caller then opens another link.

    Args:
        session: A session with the drone.
        safe_state: ``land``, ``limp`` or ``off``.
        within_s: Longest duration, seconds.
        land_s: Duration of a landing; None for the time that the height needs, which the drone knows.
    """
    descent = _Descent(session, safe_state, land_s)
    return await repeat_until_safe(descent, within_s, LOOK_S, lambda: session.link.outlives_a_loss)


def first_frames(safe_state: SafeState) -> tuple[bytes, ...]:
    """Return the first packets of a stop. They are sent at once, even on a link that may be dead."""
    match safe_state:
        case SafeState.OFF:
            return p.STOP, p.EMERGENCY_STOP
        case SafeState.LAND:
            # The order of these packets matters. ``YIELD`` to a high-level commander without a plan cuts the
            # motors.
            return p.land_with_velocity(LANDING_M_S), p.YIELD
    return (p.STOP,)


class _Descent:
    """One stop (``StopSteps``): the safe state to reach, and the order to land with its repetitions."""

    def __init__(self, session: CrazyflieSession, safe_state: SafeState, land_s: float | None) -> None:
        self._session = session
        self._safe_state = safe_state
        self._order = p.land_with_velocity(LANDING_M_S) if land_s is None else p.land(land_s)
        # When the drone accepted the order to land; None before that.
        self._accepted_s: float | None = None
        self._refused = False
        self.written = False
        self.acknowledged = False

    async def step(self) -> str:
        """Send the order once more and read the drone's state."""
        return await self._send_and_read() or self._contradicted()

    def _contradicted(self) -> str:
        """Compare the answer "the drone is safe" with the reports. Return the contradiction; empty if there is
        none, or no report.

        An answer has no number, so it may belong to an older request. A report has the drone's time.
        """
        session = self._session
        if session.repeats():
            return "the drone's reports do not change"
        flight = session.flight
        if flight is not None and session.age_s() <= FRESH_S and flight.bits.airborne:
            return "the drone's report shows it in the air"
        return ""

    async def _send_and_read(self) -> str:
        match self._safe_state:
            case SafeState.OFF:
                return await self._lock()
            case SafeState.LAND:
                return await self._land()
        return await self._cut()

    async def _lock(self) -> str:
        await self._send(*first_frames(SafeState.OFF))
        bits = await self._read_supervisor()
        if bits is None:
            return "silent"
        return "" if Bit.LOCKED in bits else "the drone is not locked"

    async def _cut(self) -> str:
        """Switch motors off and disarm.

        ``YIELD`` follows, because the firmware ages the setpoint that switches motors off, too: it would lock the
        drone after two seconds, or if it is armed again then.
        """
        await self._send(p.STOP, p.YIELD)
        return await self._disarm()

    async def _land(self) -> str:
        """Land, then cut the motors on the floor.

        A finished trajectory counts only after the drone has accepted this order. Before that it may be the
        trajectory of another order. The robot itself switches the motors off where the trajectory ends.
        """
        if self._accepted_s is None:
            await self._order_landing()
        bits = await self._read_supervisor(LANDING_LOOK_S)
        if bits is None:
            if self._accepted_s is not None:
                await self._send(self._order, p.YIELD)
            return "silent"
        if not bits.airborne or bits & (Bit.TUMBLED | Bit.LOCKED | Bit.CRASHED):
            return await self._cut()
        flies = Bit.HIGH_LEVEL_ACTIVE in bits
        if self._refused and flies and self._accepted_s is None:
            # A refusal also means acceptance here: a landing drone refuses a new order to land.
            self._accept()
        if self._accepted_s is None:
            return self._reason_not_landing()
        if flies:
            # Repeat YIELD. If the last one was lost, the drone still obeys the last setpoint. In the air, the order
            # goes before it, because these flags may be from before a late setpoint that has ended the landing. A
            # landing drone refuses the order, and flies on. On the floor, the order could start motors again.
            await self._send(*(() if self._is_down() else (self._order,)), p.YIELD)
        if trio.current_time() - self._accepted_s < NOTICED_S:
            return self._reason_not_landing() if self._refused else "still in the air"
        over = Bit.TRAJECTORY_FINISHED in bits and Bit.HIGH_LEVEL_DISABLED not in bits
        if over and self._is_down():
            return await self._cut()
        if flies == over:
            # No landing is under way, and no landing has finished. The drone obeyed a late setpoint instead, or it
            # hovers by an earlier order.
            self._accepted_s = None
            return self._reason_not_landing()
        return "still in the air"

    async def _order_landing(self) -> None:
        """Send the order to land. Send ``YIELD`` after the answer: it hands control from setpoints to the
        high-level commander.

        ``YIELD`` to a high-level commander without a plan cuts the motors, so it must not arrive before the
        order. It must not arrive much later either, because the last setpoint stays in force while the plan
        already runs. A drone that does not answer may still have received the order. It gets ``YIELD``, too,
        and right after that the order again, which repairs a ``YIELD`` without a plan.
        """
        question = p.landing_question(self._order)
        answer = await self._session.ask(question, YIELD_S)
        self.written = True
        if answer is None:
            await self._send(p.YIELD)
            answer = await self._session.ask(question, ANSWER_S)
        try:
            status = None if answer is None else p.landing_status_of(answer)
        except MalformedFrame:
            status = None
        self._refused = bool(status)
        if status == 0:
            self._accept()
            # Send ``YIELD`` twice, because the drone does not acknowledge it.
            await self._send(p.YIELD, p.YIELD)

    def _reason_not_landing(self) -> str:
        return "the drone refuses to land" if self._refused else "the drone does not land"

    def _accept(self) -> None:
        self._accepted_s = trio.current_time()
        self.acknowledged = True

    def _is_down(self) -> bool:
        flight = self._session.flight
        return flight is not None and self._session.age_s() <= FRESH_S and flight.z_m <= FLOOR_M

    async def _disarm(self) -> str:
        """Disarm the drone, which switches its motors off. Return why they are not known to be off; empty if they
        are off.

        If the answer reports the drone as disarmed, its state is not read: a drone that arms itself again still
        reports for a while that it flies.
        """
        answer = await self._session.ask(p.DISARM_QUESTION, ANSWER_S)
        try:
            if answer is not None and not p.is_armed(answer):
                self.acknowledged = True
                return ""
        except MalformedFrame:
            return "the drone's answer is damaged"
        bits = await self._read_supervisor()
        if bits is None:
            return "silent"
        return "the motors are not off" if bits.airborne else ""

    async def _send(self, *packets: bytes) -> None:
        await self._session.send(*packets)
        self.written = True

    async def _read_supervisor(self, within_s: float = ANSWER_S) -> Bit | None:
        bits = await self._session.supervisor(within_s)
        self.acknowledged = self.acknowledged or bits is not None
        return bits
