"""How the rover is stopped: over a connection of its own, without the HTTP client of the wire
process.

The root's stop channel keeps one open, so that the first zero leaves at once. It knows nothing of
the lamp, and puts it out; the wire leaves it as it was told.
"""

from __future__ import annotations

import math
from typing import ClassVar

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import KeptSession
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.http_port import HttpPort
from strands_actors.drivers.common.outcome import Outcome, names_of
from strands_actors.drivers.common.velocity_base import Standing, stop_base

from . import protocol as p
from .config import EarthRoverConfig

STEADY_S = 1.0
"""For so long of the rover's clock it must report that it stands: between the SDK process and the
rover is a network, so that a command comes after the service has answered, and a report is from
before that [assumed: both together within 1 s]."""

STOP_S = 2.7
"""How long zero is repeated: less than ``Timing.safe_s``, and than what is left of it when a link
is reached; time for a rover that reports once a second (vendor's example) to show that it
stands."""


class RoverZero:
    """A stop in the words of the service. ``lamp``: as it is to stay."""

    target = p.CONTROL
    state_target = p.DATA
    steady_s = STEADY_S

    def __init__(self, lamp: float = 0.0) -> None:
        self.body = p.encode_stop(lamp)

    def standing(self, body: bytes) -> Standing:
        """A rover that turns on the spot may report speed 0 [assumed]: its wheels must rest, too,
        where it tells how they turn."""
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
