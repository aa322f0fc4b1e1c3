"""The stop channel to a gripper: the supervising process (root) stops it after the wire process has ended.

For a serial gripper it uses a duplicate of the wire's serial port. For TCP it connects when it must stop the
gripper.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import DuplicateDescriptor
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.ports.serial_port import adopt_serial, open_serial
from strands_actors.drivers.common.ports.tcp_port import open_tcp
from strands_actors.kernel.clock import Clock

from .client import GripperClient, hold
from .config import RobotiqConfig
from .connect import OpenPort, OpenStream, open_gripper
from .protocol import Status
from .serial_client import SerialGripper


class RobotiqStopChannel(DuplicateDescriptor[RobotiqConfig, GripperClient]):
    def __init__(
        self,
        config: RobotiqConfig,
        descriptors: Sequence[int],
        clock: Clock,
        open_stream: OpenStream = open_tcp,
        open_port: OpenPort = open_serial,
    ) -> None:
        super().__init__(config, descriptors, clock)
        self._open = partial(open_gripper, config, clock, open_stream, open_port)

    @property
    def hosts(self) -> Sequence[str]:
        return () if self.config.serial else (self.config.address()[0],)

    async def hung_up(self, port: GripperClient) -> None:
        await (port.hung_up() if isinstance(port, SerialGripper) else super().hung_up(port))

    def adopt(self, descriptor: int) -> GripperClient:
        return SerialGripper(adopt_serial(descriptor, self.config.port), self.config, self.clock)

    async def open_port(self) -> GripperClient:
        return await self._open()

    async def make_safe_on(self, port: GripperClient, safe_state: SafeState) -> tuple[MotorReport, ...]:
        sent = port.sent if isinstance(port, SerialGripper) else 0
        report = await hold(port, None, self.config)
        if report.written:
            return (report,)
        if isinstance(port, SerialGripper):
            # Keep a serial port that still accepts bytes. It could not be opened again while another process (the
            # standby) has a duplicate of it.
            if port.sent == sent:
                raise WireDown(report.detail)
            return (report,)
        # The connection was lost before the status was read, so nothing was sent. Connect again and send a reset,
        # which is safe without knowing the status.
        port.close()
        self.port = await self.open_port()
        return (await hold(self.port, Status(), self.config),)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        try:
            return await super().make_safe(safe_state)
        finally:
            if not self.config.serial:
                self.close()  # Many gateways accept only one client. Leave that place to the next wire process.

    def failed(self, reason: str) -> tuple[MotorReport, ...]:
        return (self.config.report(False, False, reason),)
