"""Stop a robot that walks by its onboard controller.

The wire process and the supervising process (root) both use this code. A request is repeated until the onboard
controller has answered it and the robot's reports show that it obeys. The request depends on the safe state:

``stop``  StopMove: the robot ends its motion and its own controller keeps it on its feet. A G1 and an H1 stop
          walking. They first complete a change of posture that has already begun
``zero``  StopMove, then BalanceStand: afterwards the robot stands ready for the next velocity
``damp``  Damp, the vendor's own emergency stop: every joint brakes, and the robot sinks to the floor
"""

from __future__ import annotations

from typing import ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import KeptSession
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.kit.reporting_base import Report, stop_until_it_stands
from strands_actors.drivers.unitree.config import UnitreeConfig
from strands_actors.drivers.unitree.link import FIND_S

from .dialect import Order
from .link import WalkingLink
from .robots import BASE
from .states import SportState

STOP_S = 1.7
"""How long a stop request is repeated. Together with the time to connect, this is below the time limit of a stop
(``Timing.safe_s``)."""
REST_S = 0.3
"""If the robot refuses a stop request, how long to wait for a report that it rests anyway."""
STILL_M_S, STILL_RAD_S = 0.1, 0.15
"""Below these speeds the robot counts as standing [assumed], because a robot that balances also moves a little."""


class Stopping:
    """Stop the robot over one connection, with the methods that ``stop_until_it_stands`` needs."""

    def __init__(self, link: WalkingLink, safe_state: SafeState) -> None:
        self._link = link
        self._damps = safe_state == SafeState.DAMP
        dialect = link.dialect
        self._order: Order = dialect.damp if self._damps else dialect.stop
        self._last_report_ns = 0

    @property
    def is_open(self) -> bool:
        return self._link.sport.takes_stops

    async def connect(self) -> None:
        await self._link.find(self._link.address)

    def zero(self) -> None:
        if not self._link.send_stop(self._order):
            raise WireDown("the robot's walking service is not connected")

    async def acknowledged(self, within_s: float) -> None:
        """Wait until the service has answered a stop request that was sent after this call.

        The service handles requests in order, so it has then handled all earlier requests, too.

        Raises:
            WireDown: No answer has arrived, or the robot has refused the request and does not rest.
        """
        link, since_ns = self._link, self._link.clock.now_ns()
        if not await link.until(lambda: link.answered.get(self._order, 0) >= since_ns, within_s):
            raise WireDown("the robot does not answer")
        link.follow()
        reason = link.refused.get(self._order)
        if reason and not await link.until(lambda: self._rests_since(since_ns), min(within_s, REST_S)):
            raise WireDown(f"the robot refuses the stop: {reason}")
        self._last_report_ns = link.gait_ns

    def _rests_since(self, since_ns: int) -> bool:
        """Return True if the robot has reported, after ``since_ns``, a mode in which it does not move."""
        return self._link.gait_ns >= since_ns and self._link.is_in(self._link.dialect.rests)

    async def next_report(self, within_s: float) -> Report:
        link = self._link
        if not await link.until(lambda: link.gait_ns > self._last_report_ns, within_s) or link.gait is None:
            raise WireDown(f"the robot sends no {link.dialect.mode_source}")
        self._last_report_ns = link.gait_ns
        return Report(link.gait.stamp_ns, self._obeys(link.gait), self._shown(link.gait))

    def _obeys(self, gait: SportState) -> bool:
        dialect = self._link.dialect
        if self._damps:
            return gait.mode == dialect.damped
        if gait.mode not in dialect.walks:
            return gait.mode in dialect.rests
        return stands(gait) if gait.has_pose else self._link.reports_no_speed

    def _shown(self, gait: SportState) -> str:
        mode = self._link.dialect.name(gait.mode)
        if not gait.has_pose:
            return f"not known in {mode}"
        vx, vy, wz = gait.velocity
        return f"{vx:.2f}, {vy:.2f} m/s, {wz:.2f} rad/s in {mode}"


def stands(gait: SportState) -> bool:
    """Return True if the reported speeds show that the robot stands."""
    vx, vy, wz = gait.velocity
    return abs(vx) <= STILL_M_S and abs(vy) <= STILL_M_S and abs(wz) <= STILL_RAD_S


async def bring_down(link: WalkingLink, safe_state: SafeState) -> tuple[MotorReport, ...]:
    """Bring the robot to a safe state. Never raises. If the service is connected, the stop is sent at once."""
    outcome = await stop_until_it_stands(Stopping(link, safe_state), STOP_S)
    if safe_state == SafeState.ZERO and not outcome.detail and link.gait and link.gait.mode in link.dialect.walks:
        link.send(link.dialect.balance)  # Otherwise the robot steps on the spot until the next velocity.
    return reports(outcome)


def reports(outcome: Outcome) -> tuple[MotorReport, ...]:
    return outcome.reports(BASE, targets=(0.0,) * len(BASE))


class WalkingStopChannel(KeptSession[UnitreeConfig, WalkingLink]):
    """The stop channel: a separate DDS participant in the supervising process (root).

    It connects to the robot early, so that a stop need not wait for the connection. It receives states
    only during a stop, because 500 states a second would cost the root process too much CPU time.
    """

    SERVED_FIRST: ClassVar[bool] = False

    async def connect(self) -> WalkingLink:
        link = WalkingLink(self.config, self.clock)
        try:
            with trio.move_on_after(FIND_S):
                await link.find(self.config.port)
            if not link.sport.matched:
                raise WireDown(
                    f"{self.config.port}: the robot does not connect to the root process, which must be able to "
                    "stop it. Check the robot and the network"
                )
        except BaseException:
            link.close()
            raise
        return link

    async def keep_up(self, session: WalkingLink) -> None:
        await session.participant.run()

    async def make_safe_by(self, session: WalkingLink | None, safe_state: SafeState) -> tuple[MotorReport, ...]:
        if session is None:
            try:
                session = WalkingLink(self.config, self.clock)
            except WireDown as down:
                return reports(Outcome(False, False, str(down)))
        self.session = session
        return await bring_down(session, safe_state)
