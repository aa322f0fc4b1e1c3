"""Rigs of arms of CAN motors behind serial adapters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.drivers.can_motors.driver import CanMotors
from strands_actors.drivers.can_motors.stop_channel import CanStopChannel
from tests.drivers.can_motors import rig

from .bench import Bench, Log, Rig, on_bench
from .peer import HostilePeer, HostileStream


def _arm(robot: str) -> Callable[[HostilePeer], Bench]:
    def make(peer: HostilePeer) -> Bench:
        made = rig.Rig(robot)

        def open_port(path: str, baud: int) -> Any:
            return HostileStream(peer, made.open_port(path, baud))

        config = made.driver.config
        driver: CanMotors = made.driver
        on_bench(
            driver,
            lambda clock: type(made.wire)(config, clock, open_port),
            lambda clock: CanStopChannel(config, (), clock, open_port),
        )

        def log() -> Log:
            return [(at_s, kind) for at_s, kind, _ in made.notes]

        return Bench(driver, log)

    return make


def _other_feedback(data: bytes) -> bytes:
    """Let each feedback come from an id that no motor has."""
    return data.replace(b"t01", b"t06")


RIGS: Mapping[str, Rig] = {
    "openarm": Rig(
        _arm("openarm"),
        lambda position: {"joint_1": position[0] + 0.002},
        quick=("garbled",),
        floods={
            "feedback that nobody asked for": b"t11811800080080" + b"01C1C\r",
            "lines of another protocol": b"hello\r",
            "half a frame": b"t1118",
        },
        bombs={"a line without an end": b"T1FFFFFFF8"},
        wrong_ids={"motor": _other_feedback},
    ),
}
