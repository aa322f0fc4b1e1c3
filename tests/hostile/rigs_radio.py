"""Rig of a robot that receives packets: Crazyflie."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Mapping

import trio

from strands_actors.contract.wire import Permit
from strands_actors.drivers.crazyflie import stop_channel as crazyflie_stop
from strands_actors.drivers.crazyflie import wire as crazyflie_wire
from strands_actors.drivers.crazyflie.config import Endpoint
from strands_actors.drivers.crazyflie.driver import Crazyflie
from strands_actors.drivers.crazyflie.links import Link
from strands_actors.drivers.crazyflie.robots import TABLES as CRAZYFLIES
from strands_actors.drivers.crazyflie.twin.firmware import Firmware
from tests.drivers.crazyflie.virtual import Air

from .bench import Bench, Log, Rig
from .peer import HostilePeer, HostileStream


class _HostileLink(Link):
    """The changes of a hostile peer, made on packets instead of bytes."""

    def __init__(self, peer: HostilePeer, air: Air, log: Log, speaks: Callable[[Air], None]) -> None:
        self.name = air.name
        self._speaks = speaks
        self._stream = HostileStream(peer, air)
        self._air = air
        self._log = log

    async def write(self, packet: bytes, permit: Permit | None = None) -> None:
        if permit is not None:
            permit.check()
        peer = self._stream.peer
        peer.writes += 1
        self._stream._check()
        replies = self._air.firmware.receive(peer.garble(packet) if peer.deaf else packet)
        self._log.append((trio.current_time(), replies.kind))
        self._speaks(self._air)
        self._air.say(*replies.replies)

    async def read(self) -> bytes:
        return await self._stream.read()

    def read_waiting(self) -> bytes | None:
        return self._stream.read_waiting()

    def close(self) -> None:
        self._stream.wake()


def _crazyflie(peer: HostilePeer) -> Bench:
    firmware = Firmware(CRAZYFLIES.table("crazyflie"), trio.current_time)
    log: Log = []
    speaker: list[Air] = []  # only the last sender: the firmware answers that one

    async def open_link(endpoint: Endpoint) -> Link:
        return _HostileLink(peer, Air(firmware), log, lambda air: speaker.__setitem__(slice(None), [air]))

    @contextlib.asynccontextmanager
    async def living() -> AsyncIterator[None]:
        async def live() -> None:
            while True:
                await trio.sleep(0.01)
                firmware.pass_time()
                for air in speaker:
                    air.say(*firmware.reports())

        crazyflie_wire.open_link, wire_opens = open_link, crazyflie_wire.open_link
        crazyflie_stop.open_link, stop_opens = open_link, crazyflie_stop.open_link
        try:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(live)
                yield
                nursery.cancel_scope.cancel()
        finally:
            crazyflie_wire.open_link, crazyflie_stop.open_link = wire_opens, stop_opens

    return Bench(Crazyflie("crazyflie", "192.0.2.1", {}), lambda: log, living, firmware)


RIGS: Mapping[str, Rig] = {
    "crazyflie": Rig(
        _crazyflie,
        lambda position: {"vz": 0.0},
        quick=("older answers", "flood"),
        floods={"null packets": b"\xff", "console": b"\x00" + b"x" * 30},
        first=("takeoff",),
    ),
}
