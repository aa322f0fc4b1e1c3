"""How a Microduck is stopped, by the wire and by the root's stop channel alike: its twist is
zeroed, again and again, until its own state says that it neither is asked to walk nor does.

It stays on its feet: torque stays on, head, body and mouth keep their last targets. A skill that
has begun plays to its end, since robotd has nothing that ends one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import KeptSession
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.json_rpc_port import SaidNo
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.outcome import Outcome
from strands_actors.drivers.common.reporting_base import Report, stop_until_it_stands
from strands_actors.drivers.common.velocity_base import nothing_pending

from . import protocol as p
from .config import MicroduckConfig
from .link import ANSWER_S, DuckLink, report_of

STOP_S = 1.7
"""How long a stop is repeated: less than ``Timing.safe_s``, and than what is left of it when a
link is reached."""

GREET_S = 1.0
"""Within which robotd must answer the stop channel's ``hello``."""


class Stopping:
    """One link as a base that can be stopped (``ReportingBase``). ``pending``: whether an earlier
    request, on another connection, has not been answered: it may be carried out later."""

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
        """A hold zeroes the twist as a writer would; a stop asks for one by its name, and puts the
        theremin down, which moves the mouth."""
        port = self._link.port
        if self._safe_state == SafeState.ZERO:
            port.notify_stop(p.MOVE, p.REST)
        else:
            port.send_stop(p.STOP, {})
            port.notify_stop(p.THEREMIN, {"active": False})

    async def taken(self, within_s: float) -> None:
        """Ask for a stop, and wait for the answer: all that was said before it was taken then."""
        port = self._link.port
        try:
            accepted, reason = p.read_intent(await port.ask(p.STOP, {}, ANSWER_S))
        except (SaidNo, MalformedFrame) as problem:
            raise WireDown(f"{p.STOP}: robotd says {problem}") from None
        if not accepted:
            raise WireDown(f"{p.STOP}: robotd says no: {reason}")
        if self._pending():
            raise WireDown("an earlier request has not been answered")

    async def next_report(self, within_s: float) -> Report:
        return report_of(await self._link.next_state())


async def stop_by(
    link: DuckLink, safe_state: SafeState, within_s: float = STOP_S, pending: Callable[[], bool] = nothing_pending
) -> Outcome:
    """Never raises. Where the link is connected, the first frame leaves before the first wait."""
    return await stop_until_it_stands(Stopping(link, safe_state, pending), within_s)


class MicroduckStopChannel(KeptSession[MicroduckConfig, DuckLink]):
    """The root's own connection, greeted before anything is armed, and kept open."""

    SERVED_FIRST: ClassVar[bool] = False

    async def connect(self) -> DuckLink:
        link = DuckLink(self.config, self.clock)
        try:
            await link.connect()
            await link.greet(GREET_S)
        except MalformedFrame as malformed:
            link.close()
            raise WireDown(f"{self.config.endpoint().name}: {malformed}. Check what is served there") from None
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
