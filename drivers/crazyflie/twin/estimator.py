"""Simulate the drone's estimate of its place: where the drone believes to be, and how certain it is. Pure.

The estimate begins at the place that the parameters ``kalman.initial*`` name. From there it follows the body
exactly, because the sensors are simulated without errors. A position from outside (a motion capture system) moves
it. So the frame of the estimate is the frame of the world, shifted and turned.
"""

from __future__ import annotations

import math

from .body import FlyingBody, Target
from .trajectories import Moment, Vector

PLACE_RESET = (100.0**2, 100.0**2, 1.0)
"""Variances of x, y and z after a reset: the firmware's defaults."""
SPEED_RESET = 0.01**2
"""Variance of each speed after a reset: the firmware's default."""
PLACE_SETTLED, SPEED_SETTLED = 1e-4, 4e-4
SETTLES_1_S = 20.0
"""Variances, when they have settled, and how fast they do [assumed]."""


class Estimator:
    def __init__(self, body: FlyingBody) -> None:
        self._body = body
        self.reset((0.0, 0.0, 0.0), 0.0)

    def reset(self, xyz_m: Vector, yaw_rad: float) -> None:
        """Forget the estimate, and begin at a place. The height is measured from the floor at once."""
        self._reset_s = self._body.time_s
        self.external_m: Vector = (0.0, 0.0, 0.0)
        """The last position that was measured from outside."""
        self._off_m: Vector = (0.0, 0.0, 0.0)
        self._turn_rad = 0.0
        self._move((xyz_m[0], xyz_m[1], self._body.xyz_m[2]), yaw_rad)

    def correct(self, xyz_m: Vector, yaw_rad: float | None = None) -> None:
        """Take a position, and maybe a yaw, that was measured from outside."""
        self.external_m = xyz_m
        self._move(xyz_m, yaw_rad)

    def _move(self, xyz_m: Vector, yaw_rad: float | None) -> None:
        if yaw_rad is not None:
            self._turn_rad = yaw_rad - self._body.rpy_rad[2]
        x, y, z = self._turned(self._body.xyz_m)
        self._off_m = (xyz_m[0] - x, xyz_m[1] - y, xyz_m[2] - z)

    # -- the estimate

    @property
    def xyz_m(self) -> Vector:
        x, y, z = self._turned(self._body.xyz_m)
        dx, dy, dz = self._off_m
        return x + dx, y + dy, z + dz

    @property
    def velocity_m_s(self) -> Vector:
        return self._turned(self._body.velocity_m_s)

    @property
    def rpy_rad(self) -> Vector:
        roll, pitch, yaw = self._body.rpy_rad
        return roll, pitch, math.remainder(yaw + self._turn_rad, math.tau)

    @property
    def moment(self) -> Moment:
        return Moment(self.xyz_m, self.rpy_rad[2], self.velocity_m_s)

    @property
    def place_variances(self) -> Vector:
        """Return the variances of x, y and z, square metres."""
        x, y, z = (PLACE_SETTLED + (reset - PLACE_SETTLED) * self._unsettled for reset in PLACE_RESET)
        return x, y, z

    @property
    def speed_variances(self) -> Vector:
        """Return the variances of the speeds, square metres per square second."""
        variance = SPEED_SETTLED + (SPEED_RESET - SPEED_SETTLED) * self._unsettled
        return variance, variance, variance

    @property
    def _unsettled(self) -> float:
        return math.exp(-SETTLES_1_S * (self._body.time_s - self._reset_s))

    # -- setpoints

    def to_world(self, target: Target) -> Target:
        """Return a setpoint in the frame of the world that is given in the frame of the estimate."""
        if self._turn_rad == 0 and self._off_m == (0.0, 0.0, 0.0):
            return target
        cos, sin = math.cos(self._turn_rad), math.sin(self._turn_rad)
        dx, dy, dz = self._off_m
        if target.world:
            vx, vy = target.vx_m_s, target.vy_m_s
            target = target._replace(vx_m_s=cos * vx + sin * vy, vy_m_s=cos * vy - sin * vx)
        if target.xy_m is not None:
            x, y = target.xy_m[0] - dx, target.xy_m[1] - dy
            target = target._replace(xy_m=(cos * x + sin * y, cos * y - sin * x))
        if target.z_m is not None:
            target = target._replace(z_m=target.z_m - dz)
        if target.yaw_rad is not None:
            target = target._replace(yaw_rad=target.yaw_rad - self._turn_rad)
        return target

    def _turned(self, vector: Vector) -> Vector:
        cos, sin = math.cos(self._turn_rad), math.sin(self._turn_rad)
        x, y, z = vector
        return cos * x - sin * y, sin * x + cos * y, z
