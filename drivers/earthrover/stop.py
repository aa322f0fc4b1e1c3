"""Stop the rover over a separate connection, without the HTTP client of the wire process.

The root's stop channel keeps a connection open, so that the first zero leaves at once. It does not know
the lamp's state and switches it off. The wire keeps that state.
"""

from __future__ import annotations

import math
from typing import ClassVar

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import KeptSession
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.kit.outcome import Outcome, names_of
from strands_actors.drivers.common.kit.velocity_base import Standing, stop_base
from strands_actors.drivers.common.ports.http_port import HttpPort

from . import protocol as p
from .config import EarthRoverConfig

STEADY_S = 1.0
"""How long, on the rover's clock, it must report that it stands. There is a network between the SDK process
and the rover. So a command arrives after the service has answered, and a report is from before that
[assumed: both together within 1 s]."""

STOP_S = 2.7
"""How long zero is repeated. This is less than ``Timing.safe_s``, and less than the rest of it when a new
link has to be opened first. It is enough for a rover that reports once a second (vendor's example) to show
that it stands."""


class RoverZero:
    """The stop request of the service. It sets the lamp to ``lamp``."""

    target = p.CONTROL
    state_target = p.DATA
    steady_s = STEADY_S

    def __init__(self, lamp: float = 0.0) -> None:
        self.body = p.encode_stop(lamp)

    def standing(self, body: bytes) -> Standing:
        """Return the reported speed. A rover that turns on the spot may report speed 0 [assumed], so its
        wheels must stand, too, if it reports them."""
        data = p.decode_data(body)
        turns = (abs(rpm) for rpm in data.vectors.get("rpms", ()) if not math.isnan(rpm))
        return Standing(data.stamp_s, max(abs(data.speed), *turns, 0.0))


class EarthRoverStopChannel(KeptSession[EarthRoverConfig, HttpPort]):
    SERVED_FIRST: ClassVar[bool] = False

    async def connect(self) -> HttpPort:
        port = self.config.open_port()
        await port.open()
        return port

    async def keep_up(self, session: HttpPort) -> None:
        await session.hear()

    async def make_safe_by(self, session: HttpPort | None, safe_state: SafeState) -> tuple[MotorReport, ...]:
        try:
            self.session = session or self.config.open_port()
            outcome = await stop_base(self.session, RoverZero(), STOP_S)
        except WireDown as down:
            outcome = Outcome(False, False, str(down))
        return outcome.reports(*names_of(self.config.axes))
