"""Stop an xArm from the root process, over a separate connection that is opened when a stop is needed."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import ConnectWhenNeeded
from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.common.kit.hand import AXIS as HAND
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.ports.tcp_port import open_tcp
from strands_actors.kernel.clock import Clock

from .arms import AXES
from .config import XArmConfig
from .control import Control, OpenStream, open_control, stop
from .grippers import HAND_ID
from .hand import keep_grip


class XArmStopChannel(ConnectWhenNeeded[XArmConfig, Control]):
    def __init__(
        self, config: XArmConfig, descriptors: Sequence[int], clock: Clock, open_stream: OpenStream = open_tcp
    ) -> None:
        super().__init__(config, descriptors, clock)
        self._open_stream = open_stream

    @property
    def hosts(self) -> Sequence[str]:
        return (self.config.host,)

    async def connect(self) -> Control:
        return await open_control(self.config, self.clock, self._open_stream)

    async def make_safe_by(self, port: Control, safe_state: SafeState) -> tuple[MotorReport, ...]:
        reports = (await stop(port)).reports(AXES)
        if not self.config.gripper:
            return reports
        grip, _ = await keep_grip(port, self.config.gripper)
        return (*reports, *grip.reports((HAND,), (HAND_ID,)))

    def failed(self, reason: str, port: Control | None = None) -> tuple[MotorReport, ...]:
        return Outcome(False, False, reason).reports(self.config.axes)

    def release(self, port: Control) -> None:
        # Close after delivery, so that a frozen controller still receives the stop when it continues.
        port.close_in_order()
