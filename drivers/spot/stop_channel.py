"""The root's way to a Spot: a process with a login and connections of its own, which asserts our
e-stop endpoint. It needs no lease. When even that process is gone the endpoint lapses, and the robot
settles and cuts its motors by itself."""

from __future__ import annotations

from typing import ClassVar

from strands_actors.contract.stop_process import OwnProcess
from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.common.outcome import Outcome, names_of

from .config import SpotConfig

Reports = tuple[MotorReport, ...]

ANSWER_S = 2.0


class SpotStopChannel(OwnProcess[SpotConfig]):
    CHANNEL: ClassVar[str] = "strands_actors.drivers.spot.stop_process:EstopChannel"
    ANSWER_S: ClassVar[float] = ANSWER_S

    def failed(self, why: str) -> Reports:
        return Outcome(False, False, why).reports(*names_of(self.config.axes))
