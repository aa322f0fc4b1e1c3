"""The root's way to a gripper: a connection made for the stop."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.contract.driver import MotorReport
from strands_actors.contract.stop_channels import ConnectWhenNeeded
from strands_actors.drivers.common.tcp_port import open_tcp
from strands_actors.kernel.clock import Clock

from .client import GripperClient, OpenStream, hold, open_gripper
from .config import RobotiqConfig


class RobotiqStopChannel(ConnectWhenNeeded[RobotiqConfig, GripperClient]):
    def __init__(
        self, config: RobotiqConfig, descriptors: Sequence[int], clock: Clock, open_stream: OpenStream = open_tcp
    ) -> None:
        super().__init__(config, descriptors, clock)
        self._open_stream = open_stream

    async def connect(self) -> GripperClient:
        return await open_gripper(self.config, self.clock, self._open_stream)

    async def make_safe_by(self, port: GripperClient, safe_state: str) -> tuple[MotorReport, ...]:
        return (await hold(port, None, self.config),)

    def failed(self, why: str, port: GripperClient | None = None) -> tuple[MotorReport, ...]:
        return (self.config.report(False, False, why),)
