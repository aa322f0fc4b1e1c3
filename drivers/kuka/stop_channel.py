"""The root's way to a KUKA arm: a duplicate of the wire's socket, from which it answers once the
wire is gone.

Who has UDP port 30200 when: the wire from ``open`` to its end; after that this duplicate keeps the
same socket open, with what the controller has said meanwhile; when it is closed the port is free
for the next wire. While the wire lives nothing is read here: a message that one of us takes the
other does not see.
"""

from __future__ import annotations

import socket

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import DuplicateDescriptor
from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.common.udp_port import UdpListener

from .config import KukaConfig
from .link import answer_instead, failed

ANSWER_S = 0.5
"""At least so long it is answered, even when the arm stands before [assumed]: the session that ends
then ends at rest."""


class KukaStopChannel(DuplicateDescriptor[KukaConfig, UdpListener]):
    def adopt(self, descriptor: int) -> UdpListener:
        return UdpListener(socket.socket(fileno=descriptor), self.config.numeric_host())

    async def open_port(self) -> UdpListener:
        return await self.config.listen()

    async def make_safe_on(self, port: UdpListener, safe_state: SafeState) -> tuple[MotorReport, ...]:
        detail = "held by the root; its FRI session ends with this"
        reports = await answer_instead(port, self.config.arm, self.clock, ANSWER_S, detail)
        return reports or self.failed("the controller says nothing")

    def failed(self, why: str) -> tuple[MotorReport, ...]:
        return failed(self.config.arm, why)
