"""Joints that turn towards their targets at their greatest speed, and keep their position without
torque.

They have no gravity and no inertia, since the tree sees only the position and the speed of a joint.
"""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.physics.body import Commander

SPEED_RAD_S = 5.8
"""Speed of an STS3215 without load [assumed]."""


class Joints:
    """The attributes and methods that a servo's twin needs of its plant."""

    def __init__(self, names: Sequence[str], speed_rad_s: float = SPEED_RAD_S) -> None:
        self._speed_rad_s = speed_rad_s
        size = len(names)
        self.joints = tuple(names)
        self.spec = None
        self.time_s = 0.0
        self.position_rad = [0.0] * size
        self.velocity_rad_s = [0.0] * size
        self.effort_nm = [0.0] * size
        self.effort_limit_nm = [3.0] * size
        self.energised = [False] * size
        self.targets_rad = [0.0] * size
        self._stuck = [False] * size

    def catch_up(self, now_s: float) -> None:
        passed_s, self.time_s = now_s - self.time_s, now_s
        if passed_s <= 0.0:
            return
        most_rad = self._speed_rad_s * passed_s
        for at, here_rad in enumerate(self.position_rad):
            moves = self.energised[at] and not self._stuck[at]
            step_rad = max(-most_rad, min(most_rad, self.targets_rad[at] - here_rad)) if moves else 0.0
            self.position_rad[at] = here_rad + step_rad
            self.velocity_rad_s[at] = step_rad / passed_s

    def set_target(self, index: int, rad: float) -> None:
        self.targets_rad[index] = rad

    def torque(self, index: int) -> bool:
        return self.energised[index]

    def commander(self, index: int) -> Commander:
        return Commander.WIRE if self.energised[index] else Commander.NONE

    def set_torque(self, index: int, on: bool) -> None:
        self.energised[index] = on

    def set_stuck(self, index: int, stuck: bool) -> None:
        self._stuck[index] = stuck

    def set_effort_share(self, index: int, share: float) -> None:
        """No-op: these joints have no load."""
