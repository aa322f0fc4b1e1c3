"""How the rover is stopped: over a connection of its own, without the HTTP client of the wire process.

The root's stop channel keeps one open, so that the first zero leaves at once. It knows nothing of the lamp, and
puts it out; the wire leaves it as it was told.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import trio

from strands_actors.contract.driver import MotorReport, StopChannel, WireDown
from strands_actors.drivers.common.http_port import HttpPort
from strands_actors.drivers.common.velocity_base import Outcome, Standing, stop_base

from . import protocol as p

if TYPE_CHECKING:
    from .driver import EarthRover

STOP_S = 1.7
"""How long zero is repeated: less than ``Timing.safe_s``, and than what is left of it when a link is reached."""


class RoverZero:
    """A stop in the words of the service. ``lamp``: as it is to stay."""

    target = p.CONTROL
    state_target = p.DATA

    def __init__(self, lamp: float = 0.0) -> None:
        self.body = p.encode_stop(lamp)

    def standing(self, body: bytes) -> Standing:
        data = p.decode_data(body)
        return Standing(data.stamp_s, data.speed)


def open_port(driver: EarthRover) -> HttpPort:
    """Return a port to the service, not yet connected. Raise ``WireDown`` for an address that is none."""
    try:
        return HttpPort(*driver.address())
    except ValueError as error:
        raise WireDown(str(error)) from None


class EarthRoverStopChannel(StopChannel):
    """The root's way to the rover."""

    def __init__(self, driver: EarthRover) -> None:
        self._driver = driver
        self._port: HttpPort | None = None

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        await self._open().serve(task_status)

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        try:
            outcome = await stop_base(self._open(), RoverZero(), STOP_S)
        except WireDown as down:
            outcome = Outcome(False, False, str(down))
        return outcome.reports(self._driver)

    def close(self) -> None:
        if self._port is not None:
            self._port.close()

    def _open(self) -> HttpPort:
        self._port = self._port or open_port(self._driver)
        return self._port
