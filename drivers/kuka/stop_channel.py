"""The root's stop channel to a KUKA arm: a duplicate of the wire's socket. The root answers from it after the
wire has ended.

The ownership of UDP port 30200: the wire has it from ``open`` to its end. After that the duplicate keeps the
same socket open, with the messages that the controller has sent meanwhile. When the duplicate is closed, the
port is free for the next wire. While the wire lives, nothing is read here: a message that one process reads is
lost to the other.
"""

from __future__ import annotations

import socket

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import DuplicateDescriptor
from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.common.ports.udp_port import UdpListener

from .config import KukaConfig
from .link import answer_instead, failed

ANSWER_S = 0.5
"""The root answers for at least this long, even if the arm stands still earlier [assumed]. The session then
ends at rest."""


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
