"""Rig of an arm that exchanges a datagram in every cycle: KUKA over FRI."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Mapping
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import trio
from msgspec.structs import replace

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.udp_port import UdpListener
from strands_actors.drivers.kuka.config import KeptPort, KukaConfig
from strands_actors.drivers.kuka.driver import Kuka
from strands_actors.drivers.kuka.protocol import (
    COUNTER,
    JOINTS,
    Monitoring,
    State,
    decode_monitoring,
    encode_monitoring,
)
from strands_actors.drivers.kuka.robots import arm_of
from strands_actors.drivers.kuka.stop_channel import KukaStopChannel
from strands_actors.drivers.kuka.twin.answers import Answers
from strands_actors.drivers.kuka.twin.controller import Controller
from strands_actors.drivers.kuka.wire import KukaWire

from .bench import Bench, Log, Rig, Situation, first_joint, on_bench
from .datagrams import Datagrams, HostileSocket
from .peer import HostilePeer

SAMPLE_S = 0.01
CONTROLLER = ("192.0.2.1", 30200)


class _Listener(UdpListener):
    """The product's listener on the socket in memory."""

    def __init__(self, network: HostileSocket) -> None:
        super().__init__(cast("Any", SimpleNamespace(setblocking=bool, getsockname=lambda: ("0.0.0.0", 30200))))
        self._network = network

    def write(self, data: bytes) -> None:
        self._network.write(data)

    def fileno(self) -> int:
        return self._network.fileno()

    def close(self) -> None:
        """Do nothing: wire and root have duplicates of one socket."""

    def _receive(self) -> tuple[bytes, tuple[str, int]] | None:
        data = self._network.receive()
        return None if data is None else (data, CONTROLLER)

    async def _wait(self) -> None:
        await self._network.readable()


class _Config(KukaConfig, frozen=True):
    network: Any = None

    async def listen(self) -> UdpListener:
        return _Listener(self.network)


def _kuka(peer: HostilePeer) -> Bench:
    controller = Controller(arm_of("kuka_iiwa"), sample_ms=round(SAMPLE_S * 1e3), now_s=trio.current_time)
    answers = Answers(controller)
    log: Log = []
    inner = Datagrams(lambda data: log.append((trio.current_time(), answers.take(data))))
    network = HostileSocket(peer, inner, controller.wake_up)

    @contextlib.asynccontextmanager
    async def living() -> AsyncIterator[None]:
        async def live() -> None:
            while True:
                await trio.sleep(SAMPLE_S)
                inner.put(encode_monitoring(controller.cycle()))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(live)
            yield
            nursery.cancel_scope.cancel()

    driver = Kuka("kuka_iiwa", "192.0.2.1", {})
    config = _Config(**msgspec.structs.asdict(driver.config), network=network)
    driver.config, driver.kept = config, KeptPort(config)
    on_bench(
        driver,
        lambda clock: KukaWire(config, clock, driver.kept),
        lambda clock: KukaStopChannel(config, (), clock),
    )
    return Bench(driver, lambda: log, living)


def _next_number(data: bytes) -> bytes:
    """Change a message so that it acknowledges the answer after the last one."""
    try:
        monitoring = decode_monitoring(data)
    except MalformedFrame:
        return data
    return encode_monitoring(replace(monitoring, reflected=monitoring.reflected + 1 & COUNTER))


_HERE = (0.1,) * JOINTS
_STALE = Monitoring(
    7,
    position=_HERE,
    commanded=_HERE,
    interpolated=_HERE,
    state=State.COMMANDING_ACTIVE,
    quality=3,
    sample_ms=10,
    drives=(2,) * JOINTS,
    client_mode=1,
    overlay=1,
)

RIGS: Mapping[str, Rig] = {
    "kuka_iiwa": Rig(
        _kuka,
        first_joint(0.002, "joint1"),
        quick=("garbled", "older answers", "flood"),
        floods={
            "the same message": encode_monitoring(_STALE),
            "noise": b"\x07" * 300,
            "empty datagrams": b"\0",
        },
        bombs={"fields of 2 GB": b"\x0a\xff\xff\xff\xff\x07" * 200},
        wrong_ids={"number": _next_number},
        latest_s={
            # The controller accepts an answer only to its own message. It sends one every 10 ms.
            Situation.MOVES: 0.01,
            Situation.RESET: 0.01,
            Situation.ROOT_ENDS: 0.01,
            # There is no message to answer, so the last one is answered again.
            Situation.SILENT: 0.025,
            # The root has received no message yet. The first one has the address for the answer.
            Situation.WIRE_ENDS: 0.03,
        },
    ),
}
