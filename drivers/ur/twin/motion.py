"""The motions of a program. Each sets the joints' targets in every tick."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from strands_actors.drivers.common.physics.physics import Plant

from .pose import Frame, Vector, between, dot, moved, scaled

STANDING_RAD_S = 0.01
ARRIVED_RAD = 2e-3

BRAKING_RAD_S2 = 10.0
"""Deceleration of the joints in a stop [assumed]. The one that the control script requests is the tool's."""

BRAKING_S = 0.05
"""Lag of a servo of the twin behind its target. So a target this far ahead stops the joint from any speed
without turning back."""

TURN_PER_WAY_RAD_M = 4.0
"""For a tool that turns more than it moves: a turn of this angle takes as long as a metre [assumed]."""

LEAP_RAD = 0.1
"""A joint that would have to turn further than this in one tick cannot follow the tool."""

Solve = Callable[[Frame, Sequence[float]], Sequence[float] | None]
"""Returns the joints that bring the tool to a frame, near given joints; None if there is no solution."""


class Unreachable(Exception):
    """The tool cannot reach its goal."""


class Motion:
    """Stands where it begins. Subclasses move."""

    limp = False
    """True if the joints have no torque, so that a hand can move the arm."""

    slowed = False
    """True if the speed slider slows it down."""

    def __init__(self) -> None:
        self._target: list[float] = []

    def begin(self, plant: Plant) -> None:
        self._target = list(plant.position_rad)

    def advance(self, plant: Plant, seconds: float) -> None:
        """Set the targets of the joints after a time. Raise ``Unreachable`` if there are none."""
        for joint, rad in enumerate(self._target):
            plant.set_target(joint, rad)

    def target(self, plant: Plant) -> Sequence[float]:
        return self._target or plant.position_rad


class Hold(Motion):
    """Stop and stay."""

    def __init__(self, stand: Sequence[float] | None = None) -> None:
        """``stand``: where to stay; None for the nearest point at which the joints can stop."""
        super().__init__()
        self._stand = stand

    def begin(self, plant: Plant) -> None:
        if self._stand is not None:
            self._target = list(self._stand)
            return
        columns = zip(plant.position_rad, plant.velocity_rad_s, strict=True)
        self._target = [rad + rad_s * BRAKING_S for rad, rad_s in columns]


class Free(Motion):
    """Let a hand move the arm."""

    limp = True

    def target(self, plant: Plant) -> Sequence[float]:
        return plant.position_rad


class Servo(Motion):
    """Follow a goal that changes continually, at the joints' top speed at most. The last goal stays for
    ever."""

    def __init__(self, goal: Sequence[float]) -> None:
        super().__init__()
        self._goal = list(goal)

    def begin(self, plant: Plant) -> None:
        self._target = self._goal


class Speed(Motion):
    """Turn at constant rates for ever. A silent client does not stop it."""

    def __init__(self, rates_rad_s: Sequence[float]) -> None:
        super().__init__()
        self._rates = list(rates_rad_s)

    def advance(self, plant: Plant, seconds: float) -> None:
        self._target = [rad + rate * seconds for rad, rate in zip(self._target, self._rates, strict=True)]
        super().advance(plant, seconds)


def _led(solve: Solve, frame: Frame, joints: Sequence[float]) -> list[float]:
    """Return the joints that bring the tool to a frame in one tick. Raise ``Unreachable`` if they cannot."""
    solution = solve(frame, joints)
    if solution is None:
        raise Unreachable("the tool is led to where the arm does not reach")
    if max(abs(rad - was) for rad, was in zip(solution, joints, strict=True)) > LEAP_RAD:
        raise Unreachable("the tool is led through a singularity faster than the joints turn")
    return list(solution)


class ToolSpeed(Motion):
    """Move the tool at a constant velocity for ever. ``own_axes``: the velocity is in the tool's axes instead of
    the base's."""

    def __init__(self, start: Frame, solve: Solve, velocity: Sequence[float], own_axes: bool = False) -> None:
        super().__init__()
        self._frame, self._solve = start, solve
        self._velocity = tuple(velocity)
        self._own_axes = own_axes

    def advance(self, plant: Plant, seconds: float) -> None:
        vx, vy, vz, wx, wy, wz = self._velocity
        way, turn = scaled((vx, vy, vz), seconds), scaled((wx, wy, wz), seconds)
        if self._own_axes:
            way, turn = self._frame.turned(way), self._frame.turned(turn)
        if any(way) or any(turn):
            frame = moved(self._frame, way, turn)
            self._target = _led(self._solve, frame, self._target)
            self._frame = frame
        super().advance(plant, seconds)


class Trip(Motion):
    """Move to a goal and stay there: accelerate, cruise, brake."""

    slowed = True

    def __init__(self, way: float, speed: float, acceleration: float, duration_s: float) -> None:
        """``duration_s``, unless it is 0, replaces the speed."""
        super().__init__()
        self._way = way
        self._acceleration = max(acceleration, 1e-3)
        self._speed = _peak(way, duration_s, self._acceleration) if duration_s > 0 else max(speed, 1e-6)
        self._peak = min(self._speed, math.sqrt(way * self._acceleration))
        self._ramp_s = self._peak / self._acceleration
        self._cruise_s = (way - self._peak * self._ramp_s) / self._peak if way > 0 else 0.0
        self._gone_s = 0.0

    @property
    def _share(self) -> float:
        """The share of the way that is done, 0 to 1."""
        ramp_s, gone_s = self._ramp_s, self._gone_s
        left_s = 2 * ramp_s + self._cruise_s - gone_s
        if left_s <= 0:
            return 1.0
        if gone_s < ramp_s:
            return self._acceleration * gone_s**2 / 2 / self._way
        if left_s < ramp_s:
            return 1.0 - self._acceleration * left_s**2 / 2 / self._way
        return self._peak * (gone_s - ramp_s / 2) / self._way

    def advance(self, plant: Plant, seconds: float) -> None:
        self._gone_s += seconds
        self._go(plant, self._share)
        super().advance(plant, seconds)

    def _go(self, plant: Plant, share: float) -> None:
        raise NotImplementedError

    def arrived(self, plant: Plant) -> bool:
        if self._gone_s < 2 * self._ramp_s + self._cruise_s:
            return False
        there = zip(plant.position_rad, self._target, strict=True)
        return all(abs(rad - goal) < ARRIVED_RAD for rad, goal in there) and (
            max(abs(rad_s) for rad_s in plant.velocity_rad_s) < STANDING_RAD_S
        )


class MoveTo(Trip):
    """Move the joints to a goal. All start and end together. The speed is that of the joint with the longest
    way."""

    def __init__(
        self,
        start: Sequence[float],
        goal: Sequence[float],
        speed: float,
        acceleration: float,
        duration_s: float = 0.0,
    ) -> None:
        ways = [rad - was for rad, was in zip(goal, start, strict=True)]
        super().__init__(max(map(abs, ways)), speed, acceleration, duration_s)
        self._start, self._ways = list(start), ways

    def _go(self, plant: Plant, share: float) -> None:
        self._target = [was + way * share for was, way in zip(self._start, self._ways, strict=True)]


class MoveLine(Trip):
    """Move the tool on a straight line."""

    def __init__(
        self, start: Frame, goal: Frame, solve: Solve, speed: float, acceleration: float, duration_s: float = 0.0
    ) -> None:
        way, turn = between(start, goal)
        super().__init__(max(_length(way), _length(turn) / TURN_PER_WAY_RAD_M), speed, acceleration, duration_s)
        self._start, self._solve = start, solve
        self._line = way, turn

    def _go(self, plant: Plant, share: float) -> None:
        way, turn = self._line
        self._target = _led(self._solve, moved(self._start, scaled(way, share), scaled(turn, share)), self._target)


def _length(v: Vector) -> float:
    return math.sqrt(dot(v, v))


def _peak(way: float, duration_s: float, acceleration: float) -> float:
    """Return the speed that makes a trip last this long, or the highest possible one."""
    half = acceleration * duration_s / 2
    return max(1e-6, half - math.sqrt(max(0.0, half**2 - acceleration * way)))
