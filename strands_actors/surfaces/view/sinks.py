"""The interface of a display, such as Foxglove or Rerun."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import msgspec

from .events import Event
from .model import Frame, RobotModel
from .samples import Joint


class Reading(msgspec.Struct, frozen=True):
    """The joints of a robot at one time.

    Attributes:
        robot: Name of the robot.
        t: Wall-clock time of the sample in seconds.
        age_s: Age of the positions in seconds; -1 without a reading.
        state: State of the robot.
        epoch: Number of stops and holds.
        unit: Units of the joints, for people.
        joints: The joints.
    """

    robot: str
    t: float
    age_s: float
    state: str
    epoch: int
    unit: str
    joints: tuple[Joint, ...]

    @property
    def read_t(self) -> float:
        """Wall-clock time at which the positions were read, in seconds."""
        return max(self.t - max(self.age_s, 0.0), 0.0)


class Sink(Protocol):
    """A display. No method waits."""

    def reading(self, reading: Reading) -> None: ...

    def model(self, model: RobotModel) -> None:
        """Show the meshes of the robot from now on. This is called in a worker thread."""
        ...

    def frames(self, t: float, frames: Sequence[Frame]) -> None:
        """Show the frames of the robot's bodies, at a wall-clock time in seconds."""
        ...

    def event(self, event: Event) -> None: ...

    def picture(self, t: float, camera: str, jpeg: bytes) -> None:
        """Show a picture of a camera, which was received at a wall-clock time in seconds."""
        ...

    def topic(self, t: float, topic: str, values: dict[str, Any]) -> None:
        """Show a sample of another topic unchanged: ``presence``, ``health``, or a sensor such as ``imu``."""
        ...

    def close(self) -> None: ...
