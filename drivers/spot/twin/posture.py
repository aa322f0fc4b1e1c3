"""How the simulated Spot carries its body above its feet: offset and rotation, and where its feet then are.

The body's pose is relative to the footprint: the centre of the feet, level, at the height at which the robot stands
by default (``BodyControlParams.base_offset_rt_footprint``). A robot saturates a pose that it cannot reach
("command may be saturated to achievable or safe postures", spot/robot_command.proto). The limits are [assumed].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.drivers.common.physics.stepped import towards

from .geometry import Pose, pose_at
from .limbs import HIPS, foot_at, leg_to
from .paths import Path, held

LEVEL = (0.0,) * 6
"""The default posture: x, y, z in metres, roll, pitch, yaw in radians."""
LIMITS = (0.15, 0.10, 0.10, 0.4, 0.4, 0.6)
"""Largest offset of each of the six [assumed]. The legs cannot raise the body by more than 0.10 m."""
LOWEST_M = -0.2
"""Lowest height of the body, relative to the default [assumed]."""
SPEEDS = (0.3, 0.3, 0.3, 0.8, 0.8, 0.8)
"""Fastest change of each of the six, m/s and rad/s [assumed]."""

Offset = tuple[float, ...]


def saturated(offset: Sequence[float]) -> Offset:
    """Return the nearest posture that the robot can reach."""
    limited = [max(-limit, min(limit, value)) for value, limit in zip(offset, LIMITS, strict=True)]
    limited[2] = max(LOWEST_M, min(LIMITS[2], offset[2]))
    return tuple(limited)


class Posture:
    """The present posture, and the path that it follows."""

    def __init__(self, table: Mapping[str, Any]) -> None:
        self._table = table
        self.offset: Offset = LEVEL
        self.rates: Offset = LEVEL
        """Present change of the six, m/s and rad/s."""
        self._path = held(LEVEL)
        self.default_feet = tuple(foot_at(leg, table["stand_leg_rad"]) for leg in range(len(HIPS)))
        self.feet = self.default_feet
        """Places of the feet in the default pose of the body, in the order of the legs."""

    def follow(self, path: Path) -> None:
        self._path = path

    def hold(self) -> None:
        """Stay in the present posture."""
        self._path = held(self.offset)

    def level(self, at_once: bool = False) -> None:
        """Return to the default posture."""
        self._path = held(LEVEL)
        if at_once:
            self.offset = self.rates = LEVEL
            self.feet = self.default_feet

    def has_arrived(self, time_s: float) -> bool:
        return self._path.has_ended(time_s) and self.offset == self._path.last

    def step(self, time_s: float, step_s: float) -> None:
        goal = self._path.values_at(time_s)
        before = self.offset
        self.offset = tuple(
            towards(now, each, speed * step_s) for now, each, speed in zip(before, goal, SPEEDS, strict=True)
        )
        self.rates = tuple((now - then) / step_s for now, then in zip(self.offset, before, strict=True))

    def body(self, up: float) -> Pose:
        """Return the pose of the body, relative to the place on the floor below the centre of the feet.

        Args:
            up: How far the robot has stood up: 0 sits, 1 stands.
        """
        low, high = float(self._table["sit_m"]), float(self._table["stand_m"])
        x, y, z, roll, pitch, yaw = (value * up for value in self.offset)
        return pose_at(x, y, low + (high - low) * up + z, roll, pitch, yaw)

    def legs_rad(self, up: float) -> list[tuple[float, ...]]:
        """Return the angles of each leg: two of the hip, one of the knee. The feet stay where they are."""
        sitting, standing = self._table["sit_leg_rad"], self._table["stand_leg_rad"]
        legs = []
        above = pose_at(*self.offset).inverse()
        is_default = self.offset == LEVEL and self.feet == self.default_feet
        for leg, foot in enumerate(self.feet):
            goal = standing if is_default else leg_to(leg, above.compose(Pose(foot)).xyz) or standing
            legs.append(tuple(a + (b - a) * up for a, b in zip(sitting, goal, strict=True)))
        return legs
