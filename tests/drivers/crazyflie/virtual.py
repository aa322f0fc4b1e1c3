"""A wire with a firmware in memory at its other end, in virtual time."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence

import pytest
import trio
from trio.testing import MockClock

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie import wire as wire_module
from strands_actors.drivers.crazyflie.config import LANDING_M_S, CrazyflieConfig, Endpoint
from strands_actors.drivers.crazyflie.links import Link
from strands_actors.drivers.crazyflie.robots import TABLES
from strands_actors.drivers.crazyflie.twin.firmware import Firmware
from strands_actors.drivers.crazyflie.wire import CrazyflieWire
from strands_actors.kernel.messages import Refused

CONFIG = CrazyflieConfig("crazyflie", "192.0.2.1", 20.0, (0.05, 2.0), 3.2, 0.5)


LANDING = p.land_with_velocity(LANDING_M_S)
FALLS_M_S = 1.5
"""Faster than any landing. A drone that falls for 0.15 s is faster."""


class VirtualClock:
    """The loop's own time."""

    def now_ns(self) -> int:
        return round(trio.current_time() * 1e9)


class Allowed:
    def __init__(self) -> None:
        self.denied = ""

    def check(self) -> None:
        if self.denied:
            raise PermitDenied(self.denied)


class Air(Link):
    """A firmware at the other end. ``lose`` selects the packets of ours that do not arrive."""

    def __init__(self, firmware: Firmware) -> None:
        self.name = "memory"
        self.firmware = firmware
        self.sent: list[bytes] = []
        self.lose: Callable[[bytes], bool] = lambda packet: False
        self.mute: Callable[[bytes], bool] = lambda packet: False
        self.silent = False
        self.delays: trio.Nursery | None = None  # runs answers that take ``delay_s``
        self.delay_s = 0.0
        self._send, self._receive = trio.open_memory_channel[bytes](10000)

    async def write(self, packet: bytes, permit: object = None) -> None:
        if permit is not None:
            permit.check()  # type: ignore[attr-defined]
        self.sent.append(packet)
        if not self.lose(packet):
            self.say(*self.firmware.receive(packet).replies)

    def say(self, *packets: bytes) -> None:
        for packet in packets:
            if self.delays is not None:
                self.delays.start_soon(self._say_later, packet)
            elif not self.silent and not self.mute(packet):
                self._send.send_nowait(packet)

    async def _say_later(self, packet: bytes) -> None:
        await trio.sleep(self.delay_s)
        self._send.send_nowait(packet)

    async def read(self) -> bytes:
        return await self._receive.receive()

    def read_waiting(self) -> bytes | None:
        try:
            return self._receive.receive_nowait()
        except trio.WouldBlock:
            return None

    def handover(self) -> Sequence[int]:
        return ()

    def close(self) -> None:
        pass


class Flight:
    """An open and armed wire in virtual time, fed by its watchdog."""

    def __init__(self, air: Air, wire: CrazyflieWire) -> None:
        self.air = air
        self.wire = wire
        self.permit = Allowed()
        self.feeds = True
        self.track: list[tuple[float, float]] = []  # height and speed, twenty times a second

    async def live(self) -> None:
        """Advance the robot's time, and run the tree's cycle, twenty times a second."""
        while True:
            await trio.sleep(0.05)
            self.air.firmware.pass_time()
            body = self.air.firmware.body
            self.track.append((body.xyz_m[2], body.velocity_m_s[2]))
            self.air.say(*self.air.firmware.reports())
            if self.feeds:
                try:
                    await self.wire.feed()
                    await self.wire.read()
                except WireDown:
                    self.feeds = False

    @property
    def height_m(self) -> float:
        return self.air.firmware.body.xyz_m[2]

    def never_fell(self) -> None:
        assert min(speed for _, speed in self.track) > -FALLS_M_S

    def heights_of(self, wanted: bytes) -> list[float]:
        """Return a list that collects, from now on, the heights at which a packet was sent."""
        heights: list[float] = []

        def note(packet: bytes) -> bool:
            if packet == wanted:
                heights.append(self.height_m)
            return False

        self.air.lose = note
        return heights

    def setpoints(self) -> list[bytes]:
        return [packet for packet in self.air.sent if packet[:1] == b"\x7c"]


def fly(
    script: Callable[[Flight], Awaitable[None]],
    monkeypatch: pytest.MonkeyPatch,
    *,
    auto_arm: bool = False,
    spin_up_s: float = 0.0,
) -> None:
    async def main() -> None:
        firmware = Firmware(TABLES.table("crazyflie"), trio.current_time, auto_arm=auto_arm, spin_up_s=spin_up_s)
        air = Air(firmware)

        async def open_link(endpoint: Endpoint) -> Link:
            return air

        monkeypatch.setattr(wire_module, "open_link", open_link)
        wire = CrazyflieWire(CONFIG, VirtualClock())  # type: ignore[arg-type]
        flight = Flight(air, wire)
        flight.feeds = False
        async with trio.open_nursery() as nursery:
            nursery.start_soon(flight.live)
            await wire.open()
            await nursery.start(wire.serve)
            await wire.arm(flight.permit)
            flight.feeds = True
            await script(flight)
            nursery.cancel_scope.cancel()

    trio.run(main, clock=MockClock(autojump_threshold=0))


async def take_off(flight: Flight) -> None:
    answer = await flight.wire.perform("takeoff", {}, flight.permit)
    assert not isinstance(answer, Refused), answer
