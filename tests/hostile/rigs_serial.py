"""Rigs of robots on a serial line or bus: servos, Stretch."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import trio

from strands_actors.drivers.common.dynamixel.wire import DynamixelStopChannel
from strands_actors.drivers.feetech.wire import FeetechStopChannel
from strands_actors.drivers.stretch.driver import Stretch
from tests.drivers.common.memory_port import MemoryPort, servos
from tests.drivers.servo import rig as servo
from tests.drivers.stretch import rig as stretch

from .bench import Bench, Log, Rig, first_joint, on_bench
from .peer import HostilePeer, HostileStream


class _Logged:
    """A bus of servos that notes each message it receives."""

    def __init__(self, bus: Any, log: Log) -> None:
        self._bus = bus
        self._log = log

    def receive(self, data: bytes, bits_per_s: int | None) -> Any:
        for exchange in self._bus.receive(data, bits_per_s):
            self._log.append((trio.current_time(), exchange.kind))
            yield exchange


def _servos(rig_class: Callable[[], servo.Rig], channel_class: Any) -> Callable[[HostilePeer], Bench]:
    def make(peer: HostilePeer) -> Bench:
        made = rig_class()
        log: Log = []
        bus: Any = _Logged(made.bus, log)
        config, wire_class = made.driver.config, type(made.wire)

        def open_port(path: str, baud: int) -> HostileStream:
            return HostileStream(peer, MemoryPort(servos(bus)))

        driver = on_bench(
            made.driver,
            lambda clock: wire_class(config, clock, open_port),
            lambda clock: channel_class(config, (), clock, open_port),
        )
        return Bench(driver, lambda: log)

    return make


class _StretchRig(stretch.Rig):
    """A rig that notes the arrival of each frame."""

    def __init__(self, peer: HostilePeer) -> None:
        super().__init__()
        self.peer = peer
        self.log: Log = []

    def open_port(self, path: str, baud: int) -> HostileStream:  # type: ignore[override]
        port = super().open_port(path, baud)
        answers = port.peer

        def logged(data: bytes) -> Iterable[tuple[float, bytes]]:
            before = len(self.kinds)
            replies = list(answers(data))
            self.log += [(trio.current_time(), kind) for _, kind, _ in self.kinds[before:]]
            return replies

        port.peer = logged
        return HostileStream(self.peer, port)


def _stretch(peer: HostilePeer) -> Bench:
    made = _StretchRig(peer)
    driver = Stretch("stretch3", "", {})
    driver.config = made.config
    on_bench(driver, lambda clock: made.wire(), lambda clock: made.stop_channel())
    return Bench(driver, lambda: made.log)


RIGS: Mapping[str, Rig] = {
    "so101": Rig(
        _servos(servo.FeetechRig, FeetechStopChannel),
        first_joint(1.0, "shoulder_pan"),
        quick=("garbled", "older answers"),
        floods={"unasked answers": b"\xff\xff\x63\x02\x00\x9a", "half headers": b"\xff\xff"},
        bombs={"the longest frame": b"\xff\xff\x01\xff"},
        wrong_ids={"servo": lambda data: data[:2] + b"\x63" + data[3:]},
    ),
    "koch": Rig(
        _servos(servo.DynamixelRig, DynamixelStopChannel),
        first_joint(1.0, "shoulder_pan"),
        quick=("older answers",),
        floods={"half headers": b"\xff\xff\xfd\x00"},
        bombs={"a frame of 64 kB": b"\xff\xff\xfd\x00\x01\xff\xff"},
        wrong_ids={"servo": lambda data: data[:4] + b"\x63" + data[5:]},
    ),
    "stretch3": Rig(
        _stretch,
        lambda position: {"lift": position[2] + 0.002},
        quick=("garbled",),
        floods={"empty frames": b"\0"},
        bombs={"a frame without an end": b"\x01"},
    ),
}
