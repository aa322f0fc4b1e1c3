"""The root's way to a KUKA arm: a duplicate of the wire's socket, from which it answers once the wire is gone.

Who has UDP port 30200 when: the wire from ``open`` to its end; after that this duplicate keeps the same socket
open, with what the controller has said meanwhile; when it is closed the port is free for the next wire. While the
wire lives nothing is read here: a message that one of us takes the other does not see.
"""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

from strands_actors.contract.driver import MotorReport, StopChannel, WireDown
from strands_actors.drivers.common.udp_port import UdpListener, listen_udp
from strands_actors.kernel.clock import Clock

from .link import answer_instead, failed

if TYPE_CHECKING:
    from .driver import Kuka

ANSWER_S = 0.5
"""At least so long it is answered, even when the arm stands before [assumed]: the session that ends then ends at
rest."""


class KukaStopChannel(StopChannel):
    """``fd``: the duplicate; None: a socket of its own, opened when it is used."""

    def __init__(self, driver: Kuka, fd: int | None, clock: Clock) -> None:
        self._driver = driver
        self._clock = clock
        self._port = None if fd is None else UdpListener(socket.socket(fileno=fd), driver.numeric_host())

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        arm, detail = self._driver.arm, "held by the root; its FRI session ends with this"
        try:
            if self._port is None:
                host, number = self._driver.place()
                self._port = await listen_udp(number, host)
            reports = await answer_instead(self._port, arm, self._clock, ANSWER_S, detail)
        except (WireDown, ValueError) as down:
            return failed(arm, str(down))
        return reports or failed(arm, "the controller says nothing")

    def close(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None
