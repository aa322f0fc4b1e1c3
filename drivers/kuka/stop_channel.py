"""The stop channel to a KUKA arm: the supervising process (root) holds the arm after the wire process has ended.

It uses a duplicate of the socket that the wire process has bound to UDP port 30200. While the wire process runs,
only this process reads from the socket, because a message that one process reads is lost to the other. After its
end the duplicate keeps the socket open, with the messages that have arrived meanwhile, and the root process answers
them. When the duplicate is closed, the next wire process can bind the port.
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
"""The root process answers for at least this time, even if the arm stands still earlier [assumed]. So the arm is at
rest when the session ends."""


class KukaStopChannel(DuplicateDescriptor[KukaConfig, UdpListener]):
    def adopt(self, descriptor: int) -> UdpListener:
        return UdpListener(socket.socket(fileno=descriptor), self.config.numeric_host())

    async def open_port(self) -> UdpListener:
        return await self.config.listen()

    async def make_safe_on(self, port: UdpListener, safe_state: SafeState) -> tuple[MotorReport, ...]:
        detail = "held by the root process, which now ends the FRI session"
        reports = await answer_instead(port, self.config.arm, self.clock, ANSWER_S, detail)
        return reports or self.failed("the controller sends no messages")

    def failed(self, reason: str) -> tuple[MotorReport, ...]:
        return failed(self.config.arm, reason)
