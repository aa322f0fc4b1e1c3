"""The motions that a program on the simulated controller can make. A motion sets the joint targets in every
tick."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from strands_actors.drivers.common.physics.physics import Plant

from .pose import Frame, Vector, between, dot, moved, scaled

STANDING_RAD_S = 0.01
ARRIVED_RAD = 2e-3

BRAKING_RAD_S2 = 10.0
"""Deceleration of the joints in a stop [assumed]. The deceleration in the control script's request is for the
tool."""

BRAKING_S = 0.05
"""Time by which a simulated servo lags its target. A joint that moves this long at its present speed reaches the
point where it can stop without turning back."""

TURN_PER_DISTANCE_RAD_M = 4.0
"""If a tool mainly turns, a turn by this angle takes as long as a straight motion of one metre [assumed]."""

LEAP_RAD = 0.1
"""If a joint would have to turn further than this in one tick, it cannot follow the tool."""

Solve = Callable[[Frame, Sequence[float]], Sequence[float] | None]
"""Takes a frame of the tool and the present joint positions. Returns joint positions for this frame, or None."""


class Unreachable(Exception):
    """Raised if the tool or a joint cannot reach its goal."""


class Motion:
    """The base of all motions. By itself it holds the arm at its position at the start."""

    limp = False
    """True if the joints have no torque, so that a person can move the arm by hand."""

    slowed = False
    """True if the speed slider slows this motion down."""

    def __init__(self) -> None:
        self._target: list[float] = []

    def begin(self, plant: Plant) -> None:
        self._target = list(plant.position_rad)

    def advance(self, plant: Plant, seconds: float) -> None:
        """Advance the motion by ``seconds`` and set the joint targets. Raise ``Unreachable`` if it cannot go on."""
        for joint, rad in enumerate(self._target):
            plant.set_target(joint, rad)

    def target(self, plant: Plant) -> Sequence[float]:
        return self._target or plant.position_rad


class Hold(Motion):
    """Stop the arm and hold it."""

    def __init__(self, stand: Sequence[float] | None = None) -> None:
        """Hold the arm at ``stand`` (rad). If ``stand`` is None, hold it where its joints can stop soonest."""
        super().__init__()
        self._stand = stand

    def begin(self, plant: Plant) -> None:
        if self._stand is not None:
            self._target = list(self._stand)
            return
        columns = zip(plant.position_rad, plant.velocity_rad_s, strict=True)
        self._target = [rad + rad_s * BRAKING_S for rad, rad_s in columns]


class Free(Motion):
    """Let the joints go without torque, so that a person can move the arm by hand."""

    limp = True

    def target(self, plant: Plant) -> Sequence[float]:
        return plant.position_rad


class Servo(Motion):
    """Follow goals that a client sends in a stream, at most at the top speed of the joints.

    If no new goal arrives, the arm moves to the last goal and stays there.
    """

    def __init__(self, goal: Sequence[float]) -> None:
        super().__init__()
        self._goal = list(goal)

    def begin(self, plant: Plant) -> None:
        self._target = self._goal


class Speed(Motion):
    """Turn the joints at constant speeds, until another motion begins. A silent client does not stop them.

    The joint whose speed changes most does so at the given acceleration, and the others in the same time.
    """

    def __init__(
        self, rates_rad_s: Sequence[float], acceleration_rad_s2: float, before: Motion | None = None
    ) -> None:
        """Turn the joints.

        Args:
            rates_rad_s: Speeds of the joints.
            acceleration_rad_s2: Greatest change of a joint's speed.
            before: The motion until now. If it is a ``Speed``, too, this one continues it: a client may stream
                speeds, and the joints must not lose the way by which they follow late.
        """
        super().__init__()
        self._goal_rates = list(rates_rad_s)
        self._acceleration = max(acceleration_rad_s2, 1e-3)
        self._rates = [0.0] * len(self._goal_rates)
        self._before: Sequence[float] = ()
        if isinstance(before, Speed):
            self._rates, self._before = list(before._rates), before._target

    def begin(self, plant: Plant) -> None:
        super().begin(plant)
        self._target = list(self._before or self._target)

    def advance(self, plant: Plant, seconds: float) -> None:
        changes = [goal - rate for goal, rate in zip(self._goal_rates, self._rates, strict=True)]
        most = max(map(abs, changes))
        share = min(1.0, self._acceleration * seconds / most) if most else 1.0
        self._rates = [rate + share * change for rate, change in zip(self._rates, changes, strict=True)]
        self._target = [rad + rate * seconds for rad, rate in zip(self._target, self._rates, strict=True)]
        super().advance(plant, seconds)


def _next_joints(solve: Solve, frame: Frame, joints: Sequence[float]) -> list[float]:
    """Return the joint positions for the next frame of the tool.

    Raise ``Unreachable`` if there are no such positions, or if a joint cannot reach them in one tick.
    """
    solution = solve(frame, joints)
    if solution is None:
        raise Unreachable("the tool is led to where the arm does not reach")
    if max(abs(rad - was) for rad, was in zip(solution, joints, strict=True)) > LEAP_RAD:
        raise Unreachable("the tool is led through a singularity faster than the joints turn")
    return list(solution)


class ToolSpeed(Motion):
    """Move the tool at a constant velocity, until another motion begins.

    With ``own_axes`` the velocity is along the axes of the tool, otherwise along the axes of the base.
    """

    def __init__(self, start: Frame, solve: Solve, velocity: Sequence[float], own_axes: bool = False) -> None:
        super().__init__()
        self._frame, self._solve = start, solve
        self._velocity = tuple(velocity)
        self._own_axes = own_axes

    def advance(self, plant: Plant, seconds: float) -> None:
        vx, vy, vz, wx, wy, wz = self._velocity
        shift, turn = scaled((vx, vy, vz), seconds), scaled((wx, wy, wz), seconds)
        if self._own_axes:
            shift, turn = self._frame.turned(shift), self._frame.turned(turn)
        if any(shift) or any(turn):
            frame = moved(self._frame, shift, turn)
            self._target = _next_joints(self._solve, frame, self._target)
            self._frame = frame
        super().advance(plant, seconds)


class Trip(Motion):
    """The base of motions to a goal: accelerate, move at a constant speed, brake, and stay."""

    slowed = True

    def __init__(self, distance: float, speed: float, acceleration: float, duration_s: float) -> None:
        """Plan a motion along ``distance``. If ``duration_s`` is not 0, the speed follows from it, not from
        ``speed``."""
        super().__init__()
        self._distance = distance
        self._acceleration = max(acceleration, 1e-3)
        self._speed = _peak(distance, duration_s, self._acceleration) if duration_s > 0 else max(speed, 1e-6)
        self._peak = min(self._speed, math.sqrt(distance * self._acceleration))
        self._ramp_s = self._peak / self._acceleration
        self._cruise_s = (distance - self._peak * self._ramp_s) / self._peak if distance > 0 else 0.0
        self._elapsed_s = 0.0

    @property
    def _share(self) -> float:
        """Progress of the motion: the share of its way that is done, 0 to 1."""
        ramp_s, elapsed_s = self._ramp_s, self._elapsed_s
        remaining_s = 2 * ramp_s + self._cruise_s - elapsed_s
        if remaining_s <= 0:
            return 1.0
        if elapsed_s < ramp_s:
            return self._acceleration * elapsed_s**2 / 2 / self._distance
        if remaining_s < ramp_s:
            return 1.0 - self._acceleration * remaining_s**2 / 2 / self._distance
        return self._peak * (elapsed_s - ramp_s / 2) / self._distance

    def advance(self, plant: Plant, seconds: float) -> None:
        self._elapsed_s += seconds
        self._go(plant, self._share)
        super().advance(plant, seconds)

    def _go(self, plant: Plant, share: float) -> None:
        raise NotImplementedError

    def arrived(self, plant: Plant) -> bool:
        if self._elapsed_s < 2 * self._ramp_s + self._cruise_s:
            return False
        pairs = zip(plant.position_rad, self._target, strict=True)
        return all(abs(rad - goal) < ARRIVED_RAD for rad, goal in pairs) and (
            max(abs(rad_s) for rad_s in plant.velocity_rad_s) < STANDING_RAD_S
        )


class MoveTo(Trip):
    """Move the joints to a goal. All joints start and stop together.

    The given speed is that of the joint with the longest way.
    """

    def __init__(
        self,
        start: Sequence[float],
        goal: Sequence[float],
        speed: float,
        acceleration: float,
        duration_s: float = 0.0,
    ) -> None:
        distances = [rad - was for rad, was in zip(goal, start, strict=True)]
        super().__init__(max(map(abs, distances)), speed, acceleration, duration_s)
        self._start, self._distances = list(start), distances

    def _go(self, plant: Plant, share: float) -> None:
        self._target = [was + distance * share for was, distance in zip(self._start, self._distances, strict=True)]


class MoveLine(Trip):
    """Move the tool on a straight line to a goal."""

    def __init__(
        self, start: Frame, goal: Frame, solve: Solve, speed: float, acceleration: float, duration_s: float = 0.0
    ) -> None:
        shift, turn = between(start, goal)
        super().__init__(
            max(_length(shift), _length(turn) / TURN_PER_DISTANCE_RAD_M), speed, acceleration, duration_s
        )
        self._start, self._solve = start, solve
        self._line = shift, turn

    def _go(self, plant: Plant, share: float) -> None:
        shift, turn = self._line
        frame = moved(self._start, scaled(shift, share), scaled(turn, share))
        self._target = _next_joints(self._solve, frame, self._target)


def _length(v: Vector) -> float:
    return math.sqrt(dot(v, v))


def _peak(distance: float, duration_s: float, acceleration: float) -> float:
    """Return the top speed with which a motion along ``distance`` takes ``duration_s``.

    If this time is too short for the acceleration, return the highest speed that is possible.
    """
    half = acceleration * duration_s / 2
    return max(1e-6, half - math.sqrt(max(0.0, half**2 - acceleration * distance)))
