"""The path by which the supervising process stops position servos. It uses the port that the process which
commanded the robot had open, or opens the port again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import DuplicateDescriptor
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.ports.half_duplex import PacketT
from strands_actors.drivers.common.ports.serial_port import BytePort, adopt_serial, open_serial
from strands_actors.kernel.clock import Clock

from .codec import Codec
from .config import ServoConfig
from .safing import Safing, safing_on, unreachable


class ServoStopChannel(DuplicateDescriptor[ServoConfig, BytePort], Generic[PacketT]):
    """The supervising process's path to a servo bus. A subclass sets the codec and the ``Safing`` class of its
    protocol."""

    CODEC: Codec[PacketT]
    SAFING: type[Safing[PacketT]]

    def __init__(
        self,
        config: ServoConfig,
        descriptors: Sequence[int],
        clock: Clock,
        open_port: Callable[[str, int], BytePort] = open_serial,
    ) -> None:
        self._open = open_port
        super().__init__(config, descriptors, clock)

    async def hung_up(self, port: BytePort) -> None:
        await port.hung_up()

    def adopt(self, descriptor: int) -> BytePort:
        return adopt_serial(descriptor, self.config.port)

    async def open_port(self) -> BytePort:
        return self._open(self.config.port, self.config.baud)

    async def make_safe_on(self, port: BytePort, safe_state: SafeState) -> tuple[MotorReport, ...]:
        safing = safing_on(port, self.config, self.CODEC, self.SAFING, self.clock)
        # The positions of the servos are unknown in this process, so a hold first reads them.
        reports = await safing.hold({}) if safe_state == SafeState.HOLD else await safing.limp()
        # A hold may write no goal, for example if no servo has torque. If the port has accepted a read request, it
        # works and is kept. Another process may have a duplicate of it, which would prevent opening it again.
        if not safing.port_took_a_frame:
            raise WireDown(reports[0].detail)
        return reports

    def failed(self, reason: str) -> tuple[MotorReport, ...]:
        return unreachable(self.config.joints, reason)
