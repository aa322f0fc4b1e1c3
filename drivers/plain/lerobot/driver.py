"""Drive a robot by LeRobot's class for it. It is a ``PlainDriver`` for the class ``Follower``, with the facts of
the robot's type.

For so100, so101 and koch this package knows the servo bus. Their axes, limits and stop channel are those of this
package's own driver. For other robots a second process connects with LeRobot's class and calls its stop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import msgspec

from strands_actors.contract.driver import Candidate, Driver, GateCheck, GateState
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.loading import load
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import StopChannel
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Refused

from .. import refusals
from ..config import Deadlines
from ..driver import LEAVING, PlainDriver
from ..members import Declared
from .follower import LIMP
from .types import TYPES, Type

ARM_S = 2.0
"""Longest time for writing the goals and switching the torque on: a few frames per motor."""
OWN_STOP_S = 2.5
"""Longest time of a stop by this package's own driver. The stop may wait for a running call."""


class LeRobotDriver(PlainDriver):
    WIRE: ClassVar[str] = "strands_actors.drivers.plain.lerobot.wire:LeRobotWire"
    DEADLINES: ClassVar[Deadlines] = Deadlines(connect_s=90.0, call_s=0.5, stop_s=2.0, cleanup_s=2.0, load_s=30.0)
    """Connecting imports torch: five seconds, and a minute on a small or busy machine."""
    SIMULATION: ClassVar[str] = "LeRobot's classes have none"

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        super().__init__(robot, port, options)
        self.robot_type: Type = TYPES[robot]
        self._own: Driver | None = None
        if self.robot_type.wire:
            self._own = load(self.robot_type.wire)(robot, port, options["own"])
            self.timing = msgspec.structs.replace(self.timing, arm_s=ARM_S, safe_s=OWN_STOP_S, late_s=0.0)
        if self.robot_type.holds:
            self.gates = (*self.gates, _has_torque(self.axes))
            self.fallbacks = {
                **fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.LIMP),
                **dict.fromkeys(LEAVING, SafeState.OFF),
            }
        self.firmware_watchdog = (
            "Not known, because LeRobot's class does not declare it"
            if self._own is None
            else self._own.firmware_watchdog
        )

    @classmethod
    def options_of(cls, driver_class: type[Any], robot: str, keywords: Mapping[str, Any]) -> dict[str, Any]:
        options = super().options_of(driver_class, robot, keywords)
        robot_type = TYPES[robot]
        if not robot_type.wire:
            return options
        own_class: type[Driver] = load(robot_type.wire)
        own = own_class.resolve(robot, _calibration(keywords))
        options["own"] = own
        if keywords.get("use_degrees", True):
            declared = _declared(own_class(robot, "", own))
            options["config"]["declared"] = msgspec.to_builtins(declared)
        return options

    def preload(self) -> None:
        super().preload()
        if self._own is not None:
            self._own.preload()

    def stop_channel(self, descriptors: Sequence[int], clock: Clock) -> StopChannel:
        """Return a stop channel, the way to stop the robot without its wire process. If this package's own driver
        knows the robot's bus, the channel is that of this driver. It then uses the serial port that the wire
        process has opened and handed over."""
        if self._own is None:
            return super().stop_channel(descriptors, clock)
        return self._own.stop_channel(descriptors, clock)


def _has_torque(axes: Sequence[str]) -> GateCheck:
    def has_torque(candidate: Candidate, state: GateState) -> Refused | None:
        """Refuse to move a motor that has lost its torque. Its goal may switch the torque on again, and the arm
        jumps."""
        faults = state.observation.faults
        limp = next((axes[index] for index in candidate.named if faults.get(axes[index]) == LIMP), "")
        return refusals.no_torque(limp, LIMP) if limp else None

    return has_torque


def _calibration(keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Return the option that makes our driver use the same calibration file as LeRobot."""
    name, folder = keywords.get("tool_name"), keywords.get("calibration_dir")
    file = Path(str(folder)).expanduser() / f"{name}.json" if folder else None
    if file is not None and file.is_file():
        return {"calibration": str(file)}
    return {"tool_name": name} if name and folder is None else {}


def _declared(own: Driver) -> Declared:
    keys = {axis: f"{axis}.pos" for axis in own.axes}
    return Declared(
        keys=tuple(keys.values()),
        source="its type",
        limits={keys[axis.key]: axis.limits for axis in own.table},
        units={keys[axis.key]: axis.unit for axis in own.table},
    )
