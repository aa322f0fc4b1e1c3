"""Stop the rover over a separate connection, without the HTTP client of the wire process.

The root process keeps this connection open, so that it can send the first zero command at once. It does not know
whether the lamp is lit, so its stop switches the lamp off. A stop by the wire process keeps the lamp as it was.
"""

from __future__ import annotations

import math
from typing import ClassVar

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import KeptSession
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.kit.outcome import Outcome, names_of
from strands_actors.drivers.common.kit.velocity_base import MotionReport, stop_base
from strands_actors.drivers.common.ports.http_port import HttpPort

from . import protocol as p
from .config import EarthRoverConfig

STEADY_S = 1.0
"""How long the rover must report speed 0, on its own clock. There is a network between the SDK process and the
rover. So a command reaches the rover after the service has answered, and a report is older than the answer that
contains it [assumed: both delays together below 1 s]."""

STOP_S = 2.7
"""How long the stop command is repeated, in seconds. With the time for a new connection this is still less than
``Timing.safe_s``. A rover that reports once a second (vendor's example) can show within it that it has stopped."""


class RoverZero:
    """The stop command for the SDK process. It sets the lamp to ``lamp``."""

    target = p.CONTROL
    state_target = p.DATA
    steady_s = STEADY_S

    def __init__(self, lamp: float = 0.0) -> None:
        self.body = p.encode_stop(lamp)

    def read_motion(self, body: bytes) -> MotionReport:
        """Return the time of a report (s), and a number that is 0 if nothing moves. It is the reported speed of
        the rover, or the reported rpm of a wheel if that is larger.

        A rover that turns on the spot may report speed 0 [assumed], so the wheels must have stopped, too, if the
        rover reports them.
        """
        data = p.decode_data(body)
        turns = (abs(rpm) for rpm in data.vectors.get("rpms", ()) if not math.isnan(rpm))
        return MotionReport(data.stamp_s, max(abs(data.speed), *turns, 0.0))


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
