"""Generate the trajectory from the present position to the newest goal, one step per millisecond.

Pure. Each joint moves as fast as its limits allow, and never further than its goal. From rest all joints begin
and arrive together, on a straight line in joint space. A goal may be replaced at any time. The new one is reached
from the present speed of the joints.

There are two stages. A profile keeps speed and acceleration within the limits. A moving average over ``WINDOW``
steps then spreads each change of the acceleration over as many milliseconds, which limits the jerk. An average
of positions goes no further, no faster, and accelerates no more than the positions that it averages.

A controller that has missed a command has continued the motion by itself. The trajectory then starts from the
controller's position (``meet``), and returns to the planned path within ``FADE`` steps.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import msgspec

from .arms import JOINTS, Arm

STEP_S = 0.001
WINDOW = 4
"""Number of steps in the moving average. The profile may change the acceleration by twice its limit in one step.
Spread over 4 ms, this change keeps the jerk limit of all arms in ``robots.toml``, for any speed factor."""

ARRIVED_RAD = 1e-10
"""A joint that is so close to its goal, and slow, is put there. That adds less than 0.1 mrad/s^2."""
ROOM_RAD = 0.002
"""Margin at the end of a joint's range, where the speed is limited. A joint moves this far in the 1.5 ms by which
the moving average lags behind the profile."""
FADE = 40
"""Number of steps after which the arm is back on the planned path. A smaller number would cause more jerk, and a
larger one would take longer."""
SPAN_RAD = 1e-6
"""A joint with a shorter way than this does not wait for the others."""


class Limits(msgspec.Struct, frozen=True):
    """The limits that the generator keeps, per joint."""

    low: tuple[float, ...]
    high: tuple[float, ...]
    speed: tuple[float, ...]
    acceleration: tuple[float, ...]


def limits_of(arm: Arm, speed_factor: float) -> Limits:
    """Return the limits of an arm at a share of its speed, acceleration and jerk.

    Near the end of a joint's range the controller lowers its speed limit: |v| <= -a + sqrt(b * d). Here d is the
    distance from the end of that curve, and a, b and the ends of the curve are in ``Arm.ends``.

    A joint that brakes must stay below that limit. With the acceleration A, its speed at the distance e from the
    goal is sqrt(2 A e). It stays below the limit under two conditions: A <= b / 6, and the goal is at least 1.5 a^2
    / b away from the end of the curve. To prove this, square both sides. The worst case is at the speed a / 2.
    """
    acceleration = [most * speed_factor for most in arm.acceleration]
    low, high = list(arm.low), list(arm.high)
    for joint, (offset, slope, lower, upper) in enumerate(arm.ends):
        acceleration[joint] = min(acceleration[joint], slope / 6)
        keep = 1.5 * offset**2 / slope + ROOM_RAD
        low[joint], high[joint] = max(low[joint], lower + keep), min(high[joint], upper - keep)
    speed = tuple(most * speed_factor for most in arm.speed)
    return Limits(tuple(low), tuple(high), speed, tuple(acceleration))


class Trajectory:
    """A trajectory that begins at rest. ``start`` is the present commanded position."""

    def __init__(self, limits: Limits, start: Sequence[float]) -> None:
        self._limits = limits
        self._goal = list(start)
        self._position = list(start)
        self._speed = [0.0] * JOINTS
        self._limit = list(zip(limits.speed, limits.acceleration, strict=True))
        self._recent = deque([tuple(start)] * WINDOW, WINDOW)
        # The last three planned positions, before the correction of ``meet`` is added.
        self._path = deque([tuple(start)] * 3, 3)
        # Per joint: controller's position minus planned position, at the last ``meet`` and one and two steps
        # before.
        self._apart: Sequence[tuple[float, float, float]] = ()
        self._faded = FADE

    @property
    def arrived(self) -> bool:
        """True if the arm is commanded to the goal, and further steps would repeat this position."""
        at_rest = all(point == self._recent[-1] for point in self._recent) and self._at_goal()
        return at_rest and self._faded >= FADE

    def meet(self, position: Sequence[float], speed: Sequence[float], acceleration: Sequence[float]) -> None:
        """Continue from the controller's commanded position, and return smoothly to the planned path.

        Args:
            position: Commanded position of each joint in rad, as the controller reports it.
            speed: Commanded speed of each joint in rad/s.
            acceleration: Commanded acceleration of each joint in rad/s^2.
        """
        now, before, first = self._path[2], self._path[1], self._path[0]
        apart = []
        for joint in range(JOINTS):
            rad, rad_s, rad_s2 = position[joint], speed[joint], acceleration[joint]
            a_step_ago = rad - rad_s * STEP_S
            two_ago = a_step_ago - (rad_s - rad_s2 * STEP_S) * STEP_S
            apart.append((rad - now[joint], a_step_ago - before[joint], two_ago - first[joint]))
        self._apart, self._faded = apart, 0

    def aim(self, goal: Sequence[float]) -> None:
        """Move to ``goal`` from now on. It must be within the limits' range: nothing is clipped here."""
        self._goal = list(goal)
        top = list(zip(self._limits.speed, self._limits.acceleration, strict=True))
        if any(self._speed):
            self._limit = top  # The joints already move, and one may have to brake at full acceleration.
            return
        spans = [abs(goal_rad - rad) for goal_rad, rad in zip(goal, self._position, strict=True)]
        far = [(span, *limit) for span, limit in zip(spans, top, strict=True) if span > SPAN_RAD]
        # All joints arrive together, so scale speed and acceleration by the slowest joint. Both are shares of the
        # whole way.
        speed = min((speed / span for span, speed, _ in far), default=0.0)
        acceleration = min((acceleration / span for span, _, acceleration in far), default=0.0)
        self._limit = [
            (span * speed, span * acceleration) if span > SPAN_RAD else limit
            for span, limit in zip(spans, top, strict=True)
        ]

    def brake(self) -> None:
        """Come to rest as soon as the limits allow, and stay there."""
        top = self._limits.acceleration
        self.aim(
            [
                rad + math.copysign(_braking_distance(abs(speed), acceleration), speed)
                for rad, speed, acceleration in zip(self._position, self._speed, top, strict=True)
            ]
        )

    def step(self) -> tuple[float, ...]:
        """Return the commanded position of the next millisecond."""
        position, speeds, goal = self._position, self._speed, self._goal
        for joint, (most, acceleration) in enumerate(self._limit):
            remaining_rad, speed = goal[joint] - position[joint], speeds[joint]
            if not remaining_rad and not speed:
                continue
            change = acceleration * STEP_S
            distance = abs(remaining_rad)
            # ``braking`` is the highest speed from which the joint can still stop at the goal.
            braking = change * (math.sqrt(0.25 + 2 * distance / (change * STEP_S)) - 0.5)
            allowed = min(most, braking, distance / STEP_S)
            target_speed = math.copysign(allowed, remaining_rad)
            speed += min(change, max(-change, target_speed - speed))
            position[joint] += speed * STEP_S
            if abs(goal[joint] - position[joint]) < ARRIVED_RAD and abs(speed) <= change:
                # The next step sets the speed to zero. A goal that is new then must start from this speed.
                position[joint] = goal[joint]
            speeds[joint] = speed
        self._recent.append(tuple(position))
        path = tuple(sum(column) / WINDOW for column in zip(*self._recent, strict=True))
        self._path.append(path)
        if self._faded >= FADE:
            return path
        self._faded += 1
        now, before, first = _FADING[self._faded]
        return tuple(
            rad + now * apart[0] + before * apart[1] + first * apart[2]
            for rad, apart in zip(path, self._apart, strict=True)
        )

    def _at_goal(self) -> bool:
        return self._position == self._goal and not any(self._speed)


def _braking_distance(speed: float, acceleration: float) -> float:
    """Return the distance (rad) in which a joint stops from ``speed`` (rad/s), if it brakes in steps of a
    millisecond."""
    return speed**2 / (2 * acceleration) + speed * STEP_S / 2


def _fading(step: int) -> tuple[float, float, float]:
    """Return the weights by which ``Trajectory`` adds a fading difference to its planned path, ``step`` steps
    after ``meet``. They belong to the three differences between controller and path (``_apart``): at ``meet``, and
    one and two steps before.

    The weights come from a polynomial of the fifth degree. It passes through the three differences, and it is zero
    at the three steps that begin with ``FADE``.
    """
    ahead = (FADE - step) * (FADE + 1 - step) * (FADE + 2 - step)
    now = (step + 1) * (step + 2) / 2 * ahead / (FADE * (FADE + 1) * (FADE + 2))
    before = -step * (step + 2) * ahead / ((FADE + 1) * (FADE + 2) * (FADE + 3))
    first = step * (step + 1) / 2 * ahead / ((FADE + 2) * (FADE + 3) * (FADE + 4))
    return now, before, first


_FADING = [_fading(step) for step in range(FADE + 1)]
