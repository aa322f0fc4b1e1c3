"""Stop a Spot from the supervising process (root), by a separate login and our e-stop endpoint. No
lease is needed.

No separate process is needed, either: this package implements gRPC itself, on trio, so no foreign
code can hang. When all our processes have ended, the endpoint no longer checks in. The robot then
sits down and cuts its motors by itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import KeptSession
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.kit.outcome import Outcome, names_of
from strands_actors.kernel.clock import Clock

from .config import SpotConfig
from .control import EstopEndpoint
from .session import OpenStream, SpotSession
from .stopping import SERVICES, stop_by_estop

Reports = tuple[MotorReport, ...]

LOOK_AGAIN_S = 2.0
"""Period of the check that the session still works."""
STOP_S = 1.7
"""Longest duration of one attempt. The guardian repeats it until it is confirmed."""
WATCH_S = 1.5
"""How long an attempt observes the robot, if it need not connect first."""


class EstopChannel(KeptSession[SpotConfig, SpotSession]):
    """Stop the robot by our e-stop endpoint (our registration at the robot's e-stop, which lets us
    assert it). ``open_stream`` replaces the network in tests."""

    def __init__(
        self,
        config: SpotConfig,
        descriptors: Sequence[int],
        clock: Clock,
        open_stream: OpenStream | None = None,
    ) -> None:
        super().__init__(config, descriptors, clock)
        self._open_stream = open_stream

    async def connect(self) -> SpotSession:
        session = SpotSession(self.config, self.clock, self._open_stream)
        opened = False
        try:
            await session.open(SERVICES)
            opened = True
        finally:
            if not opened:
                session.close()
        return session

    async def keep_up(self, session: SpotSession) -> None:
        while True:
            await session.call("GetEstopConfig", {})
            await session.renew()
            await trio.sleep(LOOK_AGAIN_S)

    async def make_safe_by(self, session: SpotSession | None, safe_state: SafeState) -> Reports:
        with trio.move_on_after(STOP_S):
            try:
                if session is None:
                    session = await self.connect()
                    self.replace(session)
            except WireDown as down:
                return Outcome(False, False, str(down)).reports(*names_of(self.config.axes))
            endpoint = EstopEndpoint(session, self.config.estop_timeout_s)
            outcome = await stop_by_estop(session, endpoint, safe_state, WATCH_S)
            if not outcome.acknowledged:
                # Drop the session, because it may be dead. The next attempt connects again.
                self.replace(None)
            return outcome.reports(*names_of(self.config.axes))
        return Outcome(False, False, "silent").reports(*names_of(self.config.axes))
