"""Simulate a user's model. This simulated robot has no wire protocol. Programs drive it through the simulation
control, the socket for requests to a simulation."""

from __future__ import annotations

import time
from typing import Annotated, Any

import msgspec
import trio

from strands_actors.contract.options import option
from strands_actors.drivers.common.physics.body import Body
from strands_actors.drivers.common.physics.jointed_body import JointedBody
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin import TwinOptions, WireLog, main_of

from .onboard_policy import OnboardPolicy
from .reading import Read, read_model


class ModelTwinOptions(TwinOptions, frozen=True):
    model: Annotated[str, option("path of the MJCF or URDF")] = ""
    onboard: Annotated[str, option("``module:class`` of the policy that moves the joints while they hold")] = ""
    onboard_options: Annotated[dict[str, Any], option("its keyword arguments")] = msgspec.field(
        default_factory=dict
    )
    home: Annotated[tuple[float, ...], option("``qpos`` of the whole model at the start")] = ()


BANDWIDTH_RAD_S = 30.0
"""Bandwidth of servos for which the model has no gains: about a tenth of a second, as of a small arm
[assumed]."""

PASS_S = 0.05
"""Period of advancing the physics while no request comes."""


class ModelServer:
    """Simulate the robot of one model file. It has no wire protocol, so no fault can be set on it."""

    address = "none"

    def __init__(self, read: Read, options: ModelTwinOptions) -> None:
        self._plant = Plant(
            read.spec,
            [joint.name for joint in read.joints],
            BANDWIDTH_RAD_S,
            gains=[(joint.kp, joint.kv) for joint in read.joints],
            home_qpos=options.home,
        )
        if options.onboard:
            self._plant.balance_by(
                OnboardPolicy(self._plant, read.joints, options.onboard, options.onboard_options)
            )
        self.body: Body = JointedBody(self._plant, self._pass_time)

    def _pass_time(self) -> None:
        self._plant.catch_up(time.monotonic())

    async def serve(self) -> None:
        """Advance the simulation with real time, until cancelled."""
        while True:
            self._pass_time()
            await trio.sleep(PASS_S)

    def set_fault(self, text: str) -> None:
        raise ValueError("a simulated model has no wire protocol, so no fault can be set on it")

    def power_cycle(self) -> None:
        self._plant.go_home()

    def unplug(self) -> None: ...
    def plug(self) -> None: ...
    def freeze(self, seconds: float) -> None: ...
    def close(self) -> None: ...


def build(robot: str, options: ModelTwinOptions, log: WireLog) -> ModelServer:
    """Return the server of the model file ``options.model``. Raise ``ValueError`` if there is none, or if it cannot
    be used."""
    if not options.model:
        raise ValueError(f"{robot}: the option model is missing. Give model=PATH of an MJCF or URDF file")
    return ModelServer(read_model(options.model), options)


main = main_of(ModelTwinOptions, build)
