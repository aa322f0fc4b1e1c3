"""Simulate a user's model. There is no wire: the twin has a simulation control only."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Unpack

import trio

from strands_actors.contract.options import option
from strands_actors.drivers.common.physics.body import Body
from strands_actors.drivers.common.physics.jointed_body import JointedBody
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin import Start, TwinOptions, WireLog, read_twin_options, run_server

from .reading import Read, read_model


class ModelTwinOptions(TwinOptions, frozen=True):
    model: Annotated[str, option("path of the MJCF or URDF")] = ""
    home: Annotated[tuple[float, ...], option("``qpos`` where all of it begins")] = ()


BANDWIDTH_RAD_S = 30.0
"""Bandwidth of servos for which the model has no gains: about a tenth of a second, as of a small arm
[assumed]."""

PASS_S = 0.05
"""Period of advancing the physics while no request comes."""


class ModelServer:
    """Serves the body of one model. It has no wire, so it has no faults of a wire."""

    address = "none"

    def __init__(self, read: Read, home: Sequence[float]) -> None:
        self._plant = Plant(
            read.spec,
            [joint.name for joint in read.joints],
            BANDWIDTH_RAD_S,
            gains=[(joint.kp, joint.kv) for joint in read.joints],
            home_qpos=home,
        )
        self.body: Body = JointedBody(self._plant, self._pass_time)

    def _pass_time(self) -> None:
        self._plant.catch_up(time.monotonic())

    async def serve(self) -> None:
        """Let time pass, until cancelled."""
        while True:
            self._pass_time()
            await trio.sleep(PASS_S)

    def set_fault(self, text: str) -> None:
        raise ValueError("a simulated model has no wire, and no faults on it")

    def power_cycle(self) -> None:
        self._plant.go_home()

    def unplug(self) -> None: ...
    def plug(self) -> None: ...
    def freeze(self, seconds: float) -> None: ...
    def close(self) -> None: ...


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Simulate the model at ``options["model"]`` until interrupted.

    Raises:
        ValueError: There is no model, or it cannot be used.
    """
    given = read_twin_options(robot, ModelTwinOptions, options)
    if not given.model:
        raise ValueError(f"{robot}: it needs a model. give model=PATH, of an MJCF or URDF")
    read = read_model(given.model)

    def build(wire_log: WireLog) -> ModelServer:
        return ModelServer(read, given.home)

    run_server(build, **start)
