"""Stop a Microduck: send a zero twist until the duck reports that it stands and has no command to walk. The
process that drives the robot and the supervising process (root) use this code.

The duck stays on its feet. Torque stays on, and head, body and mouth keep their last goals. A skill that has
begun plays to its end, because robotd cannot end one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import KeptSession
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.kit.reporting_base import Report, stop_until_it_stands
from strands_actors.drivers.common.kit.velocity_base import nothing_pending
from strands_actors.drivers.common.ports.json_rpc_port import RequestFailed

from . import protocol as p
from .config import MicroduckConfig
from .link import ANSWER_S, DuckLink, report_of

STOP_S = 1.7
"""How long a stop is repeated. This is less than ``Timing.safe_s``, and less than the rest of it when a new link
has to be opened first."""

GREET_S = 1.0
"""Longest time for the answer to the stop channel's ``hello``."""


class Stopping:
    """Stop the duck by a connection to robotd, with the methods that ``stop_until_it_stands`` needs. ``pending``
    returns True if an earlier request on another connection has no answer yet, and may still be carried out."""

    def __init__(
        self, link: DuckLink, safe_state: SafeState, pending: Callable[[], bool] = nothing_pending
    ) -> None:
        self._link = link
        self._safe_state = safe_state
        self._pending = pending

    @property
    def is_open(self) -> bool:
        return self._link.is_open

    async def connect(self) -> None:
        await self._link.connect()

    def zero(self) -> None:
        """Send a zero twist. For the safe state ``zero`` it is sent as a walk command. For every other safe state
        robotd's stop method is called, and the skill "theremin", which moves the mouth, is ended."""
        port = self._link.port
        if self._safe_state == SafeState.ZERO:
            port.notify_stop(p.MOVE, p.REST)
        else:
            port.send_stop(p.STOP, {})
            port.notify_stop(p.THEREMIN, {"active": False})

    async def acknowledged(self, within_s: float) -> None:
        """Request a stop and wait for the answer. By then robotd has processed all earlier messages of this
        connection."""
        port = self._link.port
        try:
            accepted, reason = p.read_intent(await port.ask(p.STOP, {}, ANSWER_S))
        except (RequestFailed, MalformedFrame) as problem:
            raise WireDown(f"{p.STOP}: robotd answered: {problem}") from None
        if not accepted:
            raise WireDown(f"{p.STOP}: robotd refused it: {reason}")
        if self._pending():
            raise WireDown("an earlier request has no answer yet, so it may still be carried out")

    async def next_report(self, within_s: float) -> Report:
        return report_of(await self._link.next_state())


async def stop_by(
    link: DuckLink, safe_state: SafeState, within_s: float = STOP_S, pending: Callable[[], bool] = nothing_pending
) -> Outcome:
    """Stop the duck. Never raises. If the link is connected, the first message is sent before anything is waited
    for."""
    return await stop_until_it_stands(Stopping(link, safe_state, pending), within_s)


class MicroduckStopChannel(KeptSession[MicroduckConfig, DuckLink]):
    """Stop the duck from the supervising process (root), by the root's own connection. It is opened and tested
    before the robot is armed, and stays open."""

    SERVED_FIRST: ClassVar[bool] = False

    async def connect(self) -> DuckLink:
        link = DuckLink(self.config, self.clock)
        try:
            await link.connect()
            await link.greet(GREET_S)
        except MalformedFrame as malformed:
            link.close()
            raise WireDown(f"{self.config.endpoint().name}: {malformed}. Check that robotd runs there") from None
        except BaseException:
            link.close()
            raise
        return link

    async def keep_up(self, session: DuckLink) -> None:
        await session.hear()

    async def make_safe_by(self, session: DuckLink | None, safe_state: SafeState) -> tuple[MotorReport, ...]:
        self.session = session or DuckLink(self.config, self.clock)
        outcome = await stop_by(self.session, safe_state)
        return outcome.reports(self.config.axes, self.config.ids)
