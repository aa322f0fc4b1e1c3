"""The stop channel to an arm of CAN motors: the supervising process (root) stops it after the end of the wire.

It uses duplicates of the wire's descriptors, one for each bus. If one is dead, all buses are opened anew.
"""

from __future__ import annotations

from collections.abc import Sequence

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import DuplicateDescriptor
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.ports.serial_port import open_serial
from strands_actors.kernel.clock import Clock

from .can_port import CanPort, OpenPort
from .config import CanConfig
from .link import Link, failed
from .stopping import bring_down


class CanStopChannel(DuplicateDescriptor[CanConfig, Link]):
    def __init__(
        self, config: CanConfig, descriptors: Sequence[int], clock: Clock, open_port: OpenPort = open_serial
    ) -> None:
        super().__init__(config, (), clock)
        self._open_port = open_port
        if len(descriptors) == len(config.ports):
            named = zip(descriptors, config.ports, config.adapters, strict=True)
            self.port = Link(config, [CanPort.adopt(*each) for each in named], clock)

    def adopt(self, descriptor: int) -> Link:
        """Not used: an arm may have several buses, and the constructor adopts them all."""
        raise NotImplementedError

    async def open_port(self) -> Link:
        return Link.open(self.config, self.clock, self._open_port)

    async def hung_up(self, port: Link) -> None:
        async with trio.open_nursery() as nursery:
            for bus in port.ports:
                nursery.start_soon(self._until_gone, bus, nursery.cancel_scope)

    async def _until_gone(self, bus: CanPort, scope: trio.CancelScope) -> None:
        await bus.port.hung_up()
        scope.cancel()

    async def make_safe_on(self, port: Link, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the arm. A hold needs a process that repeats it, so the arm is damped instead."""
        reports = await bring_down(port, safe_state)
        if not any(report.written for report in reports):
            raise WireDown(reports[0].detail)
        return reports

    def failed(self, reason: str) -> tuple[MotorReport, ...]:
        return failed(self.config, reason)
