"""A simulated firmware with its own clock, without a link."""

from __future__ import annotations

import math

import pytest

from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie.protocol import Port
from strands_actors.drivers.crazyflie.robots import TABLES
from strands_actors.drivers.crazyflie.twin.firmware import Firmware


class Bench:
    """A firmware with its own clock."""

    def __init__(self, **options: bool) -> None:
        self.now_s = 0.0
        self.notes: list[str] = []
        self.firmware = Firmware(TABLES.table("crazyflie"), lambda: self.now_s, note=self.notes.append, **options)

    def run(self, seconds: float, packet: bytes = b"") -> None:
        """Let time pass, with 20 packets a second."""
        for _ in range(round(seconds / 0.05)):
            if packet:
                self.firmware.receive(packet)
            self.now_s += 0.05
            self.firmware.pass_time()

    def arm(self) -> None:
        """Arm, and wait until the supervisor has seen it."""
        self.firmware.receive(p.ARM)
        self.run(0.15)

    def fly(self, height_m: float = 0.5) -> None:
        self.firmware.receive(p.ARM)
        self.run(2.5, p.hover(0.0, 0.0, 0.0, height_m))
        assert self.height_m == pytest.approx(height_m, abs=0.02)

    def ask(self, port: int, channel: int, data: bytes) -> bytes:
        """Send a packet. Return the data of its only answer."""
        (reply,) = self.firmware.receive(p.encode(port, channel, data)).replies
        assert p.decode(reply)[:2] == (port, channel)
        return reply[1:]

    def order(self, data: bytes) -> int:
        """Send an order to the high-level commander. Return its status."""
        answer = self.ask(Port.HIGH_LEVEL, 0, data)
        assert answer[:3] == data[:3].ljust(3, b"\0") and len(answer) == 4
        return answer[3]

    @property
    def height_m(self) -> float:
        return self.firmware.body.xyz_m[2]

    @property
    def tilt_deg(self) -> float:
        return math.degrees(self.firmware.body.tilt_rad)
