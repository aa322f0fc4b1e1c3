"""Forward and inverse kinematics of a UR arm, in closed form.

The axes of the joints 2, 3 and 4 are parallel, and the last three axes do not meet in one point. The axis z of each
frame is the axis of the next joint. ``tests/drivers/ur/test_kinematics.py`` compares the results with the DH chain
and with the body in MuJoCo.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from .pose import Frame, Vector, dot, plus, scaled

TURN = 2.0 * math.pi

STRAIGHT = 1e-6
"""If the sine of joint 5 is below this, the wrist counts as straight. The last joint is then parallel to the joints
2, 3 and 4, so its angle can be chosen."""

ROUNDING = 1e-6
"""Tolerance for poses that are slightly beyond the arm's reach because of rounding."""


class Kinematics:
    def __init__(self, dh_m: Sequence[float], ranges_rad: Sequence[tuple[float, float]]) -> None:
        """Set the DH parameters d1, a2, a3, d4, d5, d6 (m), and the range of each joint (rad)."""
        self._d1, self._a2, self._a3, self._d4, self._d5, self._d6 = dh_m
        self._ranges_rad = tuple(ranges_rad)

    def within(self, joints: Sequence[float]) -> bool:
        """Return True if each joint is within its range."""
        return all(low <= rad <= high for rad, (low, high) in zip(joints, self._ranges_rad, strict=True))

    def flange(self, joints: Sequence[float]) -> Frame:
        q1, q2, q3, q4, q5, q6 = joints
        c1, s1 = math.cos(q1), math.sin(q1)
        c5, s5, c6, s6 = math.cos(q5), math.sin(q5), math.cos(q6), math.sin(q6)
        q23 = q2 + q3
        c, s = math.cos(q23 + q4), math.sin(q23 + q4)
        side = (s1, -c1, 0.0)  # Direction of the three parallel axes, those of the joints 2, 3 and 4.
        along = (c1 * c, s1 * c, s)
        down = (c1 * s, s1 * s, -c)  # Direction of the axis of joint 5.
        x5 = (c5 * along[0] + s5 * side[0], c5 * along[1] + s5 * side[1], c5 * along[2])
        ahead = (-s5 * along[0] + c5 * side[0], -s5 * along[1] + c5 * side[1], -s5 * along[2])
        out = self._a2 * math.cos(q2) + self._a3 * math.cos(q23)
        up = self._a2 * math.sin(q2) + self._a3 * math.sin(q23)
        d4, d5, d6 = self._d4, self._d5, self._d6
        return Frame(
            (
                c1 * out + d4 * side[0] + d5 * down[0] + d6 * ahead[0],
                s1 * out + d4 * side[1] + d5 * down[1] + d6 * ahead[1],
                self._d1 + up + d5 * down[2] + d6 * ahead[2],
            ),
            (c6 * x5[0] - s6 * down[0], c6 * x5[1] - s6 * down[1], c6 * x5[2] - s6 * down[2]),
            (-s6 * x5[0] - c6 * down[0], -s6 * x5[1] - c6 * down[1], -s6 * x5[2] - c6 * down[2]),
            ahead,
        )

    def elbow(self, joints: Sequence[float]) -> Vector:
        """Return the position of joint 3 (the elbow) in the base's frame, in m."""
        out = self._a2 * math.cos(joints[1])
        return out * math.cos(joints[0]), out * math.sin(joints[0]), self._d1 + self._a2 * math.sin(joints[1])

    def joints(self, flange: Frame, near: Sequence[float], follow: bool = False) -> tuple[float, ...] | None:
        """Return joint positions (rad) within their ranges for a frame of the flange, or None if there are no such.

        If several solutions exist, the one nearest to ``near`` is returned. With ``follow``, only solutions in the
        same posture as ``near`` are used.
        """
        best: tuple[float, ...] | None = None
        least = math.inf
        wrist = plus(flange.place, scaled(flange.z, -self._d6))
        distance = math.hypot(wrist[0], wrist[1])
        if distance < ROUNDING or abs(self._d4) > distance + ROUNDING:
            return None  # The wrist would be within d4 of the base's axis, where the arm cannot reach.
        bearing, offset = math.atan2(wrist[1], wrist[0]), math.asin(max(-1.0, min(1.0, self._d4 / distance)))
        shoulders: tuple[float, ...] = (bearing + offset, bearing + math.pi - offset)
        if follow:
            shoulders = (min(shoulders, key=lambda rad: abs(math.remainder(rad - near[0], TURN))),)
        for q1 in shoulders:
            side = (math.sin(q1), -math.cos(q1), 0.0)
            c5 = dot(flange.z, side)
            if abs(c5) > 1.0 + ROUNDING:
                continue
            for sign in (math.copysign(1.0, math.sin(near[4])),) if follow else (1.0, -1.0):
                q5 = sign * math.acos(max(-1.0, min(1.0, c5)))
                for solution in self._bent(flange, q1, q5, side, near, follow):
                    change = sum(abs(rad - was) for rad, was in zip(solution, near, strict=True))
                    if change < least:
                        least, best = change, solution
        return best

    def _bent(
        self, flange: Frame, q1: float, q5: float, side: Vector, near: Sequence[float], follow: bool
    ) -> list[tuple[float, ...]]:
        """Return all complete solutions that have these positions of the joints 1 and 5."""
        s5 = math.sin(q5)
        q6 = math.atan2(-dot(flange.y, side) / s5, dot(flange.x, side) / s5) if abs(s5) > STRAIGHT else near[5]
        c6, s6 = math.cos(q6), math.sin(q6)
        down = scaled(plus(scaled(flange.x, s6), scaled(flange.y, c6)), -1.0)
        radial = (math.cos(q1), math.sin(q1), 0.0)
        q234 = math.atan2(dot(down, radial), -down[2])
        place = flange.place
        d4, d5, d6 = self._d4, self._d5, self._d6
        rest = (
            place[0] - d4 * side[0] - d5 * down[0] - d6 * flange.z[0],
            place[1] - d4 * side[1] - d5 * down[1] - d6 * flange.z[1],
            place[2] - self._d1 - d5 * down[2] - d6 * flange.z[2],
        )
        out, up = dot(rest, radial), rest[2]
        a2, a3 = self._a2, self._a3
        c3 = (out * out + up * up - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
        if abs(c3) > 1.0 + ROUNDING:
            return []
        bend = math.acos(max(-1.0, min(1.0, c3)))
        solutions = []
        for q3 in (math.copysign(bend, math.sin(near[2])),) if follow else (bend, -bend):
            q2 = math.atan2(up, out) - math.atan2(a3 * math.sin(q3), a2 + a3 * math.cos(q3))
            raw = (q1, q2, q3, q234 - q2 - q3, q5, q6)
            wound = [self._wound(joint, rad, near[joint]) for joint, rad in enumerate(raw)]
            whole = [rad for rad in wound if rad is not None]
            if len(whole) == len(raw):
                solutions.append(tuple(whole))
        return solutions

    def _wound(self, joint: int, rad: float, near: float) -> float | None:
        """Return ``rad`` plus the whole turns that bring it nearest to ``near`` within the joint's range.

        Return None if no such angle is within the range.
        """
        low, high = self._ranges_rad[joint]
        nearest = rad + TURN * round((near - rad) / TURN)
        fitting = [turned for turned in (nearest, nearest - TURN, nearest + TURN) if low <= turned <= high]
        return min(fitting, key=lambda turned: abs(turned - near), default=None)
