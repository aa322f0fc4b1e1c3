"""The mobile base of the simulated robot: two driven wheels, whose motion the odometry adds up.

Only odometry and wheels move. In the scene the robot stays at its place, because its body is fixed there.
"""

from __future__ import annotations

from math import cos, sin

from .urdf import RADIUS_M, TRACK_M

WHEEL_RAD_S = 15.707963268
"""Largest speed of a wheel, from the vendor's model."""


def clipped(value: float, most: float) -> float:
    return max(-most, min(most, value))


class Base:
    def __init__(self) -> None:
        self.pose = (0.0, 0.0, 0.0)  # x and y in metres, heading in rad
        self.velocity = (0.0, 0.0)  # forwards in m/s, to the left in rad/s
        self.wheels_rad = [0.0, 0.0]

    @staticmethod
    def wheels_of(velocity: tuple[float, float]) -> tuple[float, float]:
        """Return the speeds of the right and the left wheel. Both turn about the axis to the right, as in the
        vendor's model, so a positive speed moves the base backwards."""
        forwards, turning = velocity
        side = turning * TRACK_M / 2
        return -(forwards + side) / RADIUS_M, -(forwards - side) / RADIUS_M

    @staticmethod
    def velocity_of(right_rad_s: float, left_rad_s: float) -> tuple[float, float]:
        """Return the velocity of the base at these speeds of the wheels."""
        right, left = -right_rad_s * RADIUS_M, -left_rad_s * RADIUS_M
        return (right + left) / 2, (right - left) / TRACK_M

    def slow_down(self, elapsed_s: float, limit: tuple[float, float]) -> None:
        """Slow down towards a stand, at this acceleration."""
        forwards, turning = (
            value - clipped(value, most * elapsed_s) for value, most in zip(self.velocity, limit, strict=True)
        )
        self.velocity = forwards, turning

    def halt(self) -> None:
        self.velocity = (0.0, 0.0)

    def advance(self, elapsed_s: float) -> None:
        """Move for this time."""
        if self.velocity == (0.0, 0.0):
            return
        for wheel, rad_s in enumerate(self.wheels_of(self.velocity)):
            self.wheels_rad[wheel] += rad_s * elapsed_s
        x, y, heading = self.pose
        forwards, turning = self.velocity
        middle = heading + turning * elapsed_s / 2
        way = forwards * elapsed_s
        self.pose = (x + way * cos(middle), y + way * sin(middle), heading + turning * elapsed_s)
