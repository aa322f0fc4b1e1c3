"""The root's way to a KUKA arm: a duplicate of the wire's socket, from which it answers once the wire is gone.

Who has UDP port 30200 when: the wire from ``open`` to its end; after that this duplicate keeps the same socket
open, with what the controller has said meanwhile; when it is closed the port is free for the next wire. While the
wire lives nothing is read here: a message that one of us takes the other does not see.
"""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

import trio

from strands_actors.drivers.common.udp_port import UdpListener
from strands_actors.runtime.clock import NS, Clock
from strands_actors.runtime.contract import MotorReport, SecondPath, WireDown

from .link import Link, first_message
from .protocol import Monitoring

if TYPE_CHECKING:
    from .driver import Kuka

HEAR_S = 0.3
"""A controller that says nothing for so long is not there."""
ANSWER_S = 0.5
"""At least so long it is answered, even when the arm stands before [assumed]: the session that ends then ends at
rest."""


class KukaStopChannel(SecondPath):
    def __init__(self, driver: Kuka, fd: int, clock: Clock) -> None:
        self._driver = driver
        self._clock = clock
        self._port = UdpListener(socket.socket(fileno=fd), driver.numeric_host())

    async def make_safe(self, rung: str) -> tuple[MotorReport, ...]:
        """Answer in the wire's place with the last commanded position, as the controller has it, until the arm
        stands. Sequence numbers go on from what the controller says."""
        said: Monitoring | None = None
        try:
            with trio.move_on_after(HEAR_S):
                said = await first_message(self._port)
            if said is None:
                return self._failed("the controller says nothing")
            return await self._answer(Link(self._port, self._driver.arm, self._clock, said))
        except WireDown as down:
            return self._failed(str(down))

    async def _answer(self, link: Link) -> tuple[MotorReport, ...]:
        """Raise ``WireDown``."""
        began_ns = self._clock.now_ns()

        async def cycle() -> None:
            link.answer(await link.hear())

        link.answer(link.said)
        reports = await link.bring_to_stand(cycle, "held by the root; its FRI session ends with this")
        while self._clock.now_ns() - began_ns < ANSWER_S * NS:
            with trio.move_on_after(HEAR_S):
                await cycle()
        return reports

    def _failed(self, why: str) -> tuple[MotorReport, ...]:
        axes = enumerate(self._driver.axes, 1)
        return tuple(MotorReport(axis, number, False, False, False, why) for number, axis in axes)

    def close(self) -> None:
        self._port.close()
