"""Simulate a robot from a model file of the user. Such a robot has no hardware."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from strands_actors.contract.arm_model import ArmModel
from strands_actors.contract.axis import Axis, Part, PartKind
from strands_actors.contract.driver import Driver, Reason, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Observation

_log = logging.getLogger("strands_actors")

BUILDER = "strands_actors.drivers.model.tool:build"
"""Builds the model with which poses of its tool are computed."""

OF_BASE = ("base_xyz_m", "rpy_rad", "gyro_rad_s")
"""Readings of a base that moves freely, in ``state()``."""

CONTROL_HZ = 50.0
"""Default rate of a policy."""


class ModelDriver(Driver):
    """The driver of a robot that is simulated from the user's model file.

    ``options``: ``model`` is the path of the file. ``joints`` lists its joints, so that only the process that
    simulates the robot reads the file again.
    """

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ()
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    TRANSPORTS: ClassVar[tuple[str, ...]] = ()
    TWIN: ClassVar[str] = "strands_actors.drivers.model.twin:main"

    unit = "radians (slides: metres)"
    timing = Timing(control_hz=CONTROL_HZ, keepalive_s=1.0, oneshot_ttl_s=None)
    fallbacks: Mapping[Reason, SafeState] = fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.LIMP)
    firmware_watchdog = "A simulation holds its last target"
    gates = ()

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Read the model file, and return the options of the driver.

        Raises:
            ValueError: The model cannot be used. The message has the reason.
        """
        # Import MuJoCo only here, since only a robot with a model needs it.
        from .reading import read_model
        from .tool import tool_of

        read = read_model(options["model"])
        tool = tool_of(read.spec.copy().compile(), [joint.name for joint in read.joints])
        if read.omitted_visuals:
            _log.warning(
                "%s: left out of the pictures, nothing else of it changes: %s",
                options["model"],
                "; ".join(map(str, read.omitted_visuals)),
            )
        return {
            "model": str(options["model"]),
            "joints": [
                [joint.name, _bounded(joint.low), _bounded(joint.high), joint.slides] for joint in read.joints
            ],
            "tool": None if tool is None else tool._asdict(),
            "keyframes": {name: list(values) for name, values in read.keyframes.items()},
        }

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        self.robot = robot
        self.config = None
        axes = tuple(
            Axis(key=name, unit="m" if slides else "rad", low=_end(low, -1), high=_end(high, 1), id=number)
            for number, (name, low, high, slides) in enumerate(options["joints"])
        )
        self.declare(Part(PartKind.ARM, axes))
        self._model, self._tool = options["model"], options.get("tool")

    def readings(self, observation: Observation) -> dict[str, Any]:
        return {name: list(observation.sensors[name]) for name in OF_BASE if name in observation.sensors}

    def arm_model(self, sensors: Mapping[str, tuple[float, ...]]) -> ArmModel | None:
        if self._tool is None:
            return None
        site, link, joints = self._tool["site"], self._tool["link"], tuple(self._tool["joints"])
        return ArmModel({"model": self._model}, joints, link, site=site, builder=BUILDER)


def _bounded(end: float) -> float | None:
    """Return the end of a joint's range; None if it is infinite, since the options are sent as JSON, which has no
    infinity."""
    return end if math.isfinite(end) else None


def _end(end: float | None, sign: int) -> float:
    return sign * math.inf if end is None else end
