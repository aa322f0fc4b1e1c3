"""Combine the mode and the pose of a robot that reports them separately (G1 and H1). No I/O, no clock.

The time of the combined state is that of the older of the two reports. If the robot has never reported its pose,
the pose in the combined state is NaN.
"""

from __future__ import annotations

import math

from strands_actors.kernel.clock import NS

from .states import SportState

NOWHERE = (math.nan,) * 3
AT_LEAST_NS = NS // 100
"""Shortest time between two poses from which a speed is computed."""
AT_MOST_NS = NS


class Odometry:
    """Collects reports of the mode and of the pose. A report that is older than the last one is ignored."""

    def __init__(self) -> None:
        self._mode = 0
        self._mode_ns = 0
        self._pose: SportState | None = None
        self._pose_ns = 0
        self._before: tuple[int, tuple[float, float, float]] | None = None

    @property
    def reports_speed(self) -> bool:
        return self._pose is not None

    @property
    def stamp_ns(self) -> int:
        """The time of the combined state. 0 if the mode is unknown."""
        return min(self._mode_ns, self._pose_ns) if self.reports_speed else self._mode_ns

    def state(self) -> SportState | None:
        """Return the combined state. None if the mode is unknown."""
        if not self._mode_ns:
            return None
        if self._pose is None:
            return SportState(self._mode_ns, self._mode, NOWHERE, NOWHERE, (math.nan,) * 4, math.nan)
        return self._pose._replace(mode=self._mode, stamp_ns=self.stamp_ns)

    def take_mode(self, mode: int, t_ns: int) -> None:
        if t_ns > self._mode_ns:
            self._mode, self._mode_ns = mode, t_ns

    def take_state(self, state: SportState, t_ns: int) -> None:
        """Store the pose and the speed in a SportModeState. Its mode is not valid on these robots."""
        if t_ns > self._pose_ns:
            self._pose, self._pose_ns = state, t_ns

    def take_pose(self, pose: tuple[float, float, float], t_ns: int) -> None:
        """Store a pose: x and y in m, and the heading in rad. The speed is computed from two successive poses."""
        before, self._before = self._before, (t_ns, pose)
        if before is None or not AT_LEAST_NS <= t_ns - before[0] <= AT_MOST_NS:
            return
        passed_s = (t_ns - before[0]) / NS
        dx, dy = pose[0] - before[1][0], pose[1] - before[1][1]
        turned = math.remainder(pose[2] - before[1][2], math.tau)
        heading = pose[2] - turned / 2.0
        cos, sin = math.cos(heading), math.sin(heading)
        velocity = (cos * dx + sin * dy) / passed_s, (cos * dy - sin * dx) / passed_s, turned / passed_s
        half = pose[2] / 2.0
        orientation = math.cos(half), 0.0, 0.0, math.sin(half)
        self.take_state(SportState(t_ns, 0, (*pose[:2], 0.0), velocity, orientation, math.nan), t_ns)
