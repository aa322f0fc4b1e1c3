"""Rigs of robots behind HTTP/2: RB-Y1, Spot."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import AsyncIterator, Mapping

import trio

from tests.drivers.rby1 import rig as rby1
from tests.drivers.spot import rig as spot

from .bench import Bench, Rig, Situation, first_joint, on_bench, renumbered
from .peer import HostilePeer, HostileStream


def _h2(kind: int, payload: bytes = b"", flags: int = 0, stream: int = 0) -> bytes:
    return len(payload).to_bytes(3, "big") + bytes((kind, flags)) + stream.to_bytes(4, "big") + payload


_H2_FLOODS = {
    "pings": _h2(6, b"12345678"),
    "settings": _h2(4),
    "empty data": _h2(0, stream=1),
    "window updates": _h2(8, struct.pack(">I", 1)),
    "unknown frames": _h2(0x55),
}
_H2_BOMBS = {
    "a frame of 16 MB": b"\xff\xff\xff\x00\x00\x00\x00\x00\x01",
    "a message of 4 GB": _h2(0, b"\0\xff\xff\xff\xff", stream=1),
}


def _rby1(peer: HostilePeer) -> Bench:
    world = rby1.World()

    async def open_stream(host: str, port: int) -> HostileStream:
        return HostileStream(peer, await rby1.World.open_stream(world, host, port))

    world.open_stream = open_stream  # type: ignore[assignment, method-assign]
    driver = on_bench(world.driver, lambda clock: world.wire(), lambda clock: world.stop_channel())
    return Bench(driver, lambda: [(entry.t_s, entry.kind) for entry in world.written], world.living)


def _spot(peer: HostilePeer) -> Bench:
    world = spot.World()

    async def open_stream(authority: str, /) -> HostileStream:
        return HostileStream(peer, await spot.World.open_stream(world, authority))

    @contextlib.asynccontextmanager
    async def living() -> AsyncIterator[None]:
        async def live() -> None:
            while True:
                world.twin.pass_time()
                await trio.sleep(0.1)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(live)
            yield
            nursery.cancel_scope.cancel()

    world.open_stream = open_stream  # type: ignore[assignment, method-assign]
    driver = on_bench(world.driver, lambda clock: world.wire(), lambda clock: world.stop_channel())
    return Bench(driver, lambda: [(entry.t_s, entry.kind) for entry in world.taken], living)


RIGS: Mapping[str, Rig] = {
    "rby1": Rig(
        _rby1,
        first_joint(0.002, "torso_0"),
        quick=("flood", "bomb"),
        floods=_H2_FLOODS,
        bombs=_H2_BOMBS,
        wrong_ids={"stream": renumbered(5, 4)},
    ),
    "spot": Rig(
        _spot,
        lambda position: {"vx": 0.2},
        quick=("garbled",),
        floods=_H2_FLOODS,
        bombs=_H2_BOMBS,
        wrong_ids={"stream": renumbered(5, 4)},
        first=("stand",),
        # A login, and a new lease if the old one was lost: two answers of 1 ms.
        latest_s={Situation.RESET: 0.001, Situation.WIRE_ENDS: 0.002},
    ),
}
