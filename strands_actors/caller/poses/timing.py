"""Give a planned motion of a tool its time, and turn it into setpoints at the control rate. Pure.

The tool moves along its path as a joint of ``move_to`` does: at rest at both ends, fastest in the middle. The time
follows from the speed of the tool. It is made longer if a joint, or a gate of the driver, needs that.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from strands_actors.contract.arm_model import ArmModel
from strands_actors.contract.driver import Driver, GateState
from strands_actors.kernel.messages import Refused

from ..session.motions import (
    LONGEST_S,
    MOVE_TO,
    PEAK,
    STRETCH,
    TOO_FAST,
    Motion,
    RobotReading,
    arrived,
    minimum_jerk,
    refuse_action,
    state_of,
)
from . import refusals
from .arm import Array
from .curve import along
from .plans import PosePlan

LEAST_S = 0.3
"""Shortest motion. An arm cannot follow a shorter one smoothly, however near its goal is."""
SPEED_SHARE = 0.75
"""Share of a joint's top speed that a motion uses. An arm follows with a delay, and may have to catch up."""
LONGEST_STRETCH = 20.0
"""A motion that joints make longer by more than this passes too close to a singularity."""
SAMPLES = 200
MOVED_RAD = math.radians(3)
"""A joint that moved farther while its motion was planned makes the plan useless."""


class Units(NamedTuple):
    """The conversion of a driver's values: ``value = zero + scale * rad``, by joint."""

    axes: tuple[int, ...]
    zero: Array
    scale: Array

    def rad(self, values: Sequence[float]) -> Array:
        return (np.array([values[axis] for axis in self.axes]) - self.zero) / self.scale

    def values(self, rad: Array) -> list[float]:
        values: list[float] = (self.zero + self.scale * rad).tolist()
        return values


class TimedPlan(NamedTuple):
    """A plan with its duration.

    Attributes:
        plan: The plan.
        steps: Number of control periods.
    """

    plan: PosePlan
    steps: int


def units_of(driver: Driver, joints: Sequence[str]) -> Units:
    """Return the conversion between the driver's values of these joints and rad."""
    axes = tuple(driver.axes.index(joint) for joint in joints)
    units = driver.model_units()
    return Units(axes, np.array([units[axis][0] for axis in axes]), np.array([units[axis][1] for axis in axes]))


def limits_of(driver: Driver, model: ArmModel) -> tuple[Array, Array]:
    """Return the least and the greatest position of each joint of an arm in rad."""
    ranges = model.ranges or [
        sorted((end - zero) / scale for end in (driver.table[axis].low, driver.table[axis].high))
        for axis, zero, scale in zip(*units_of(driver, model.joints), strict=True)
    ]
    low, high = zip(*ranges, strict=True)
    return np.array(low), np.array(high)


def time_plan(
    driver: Driver, plan: PosePlan, speed_m_s: float, reading: RobotReading, period_s: float
) -> TimedPlan | Refused:
    """Return the plan with the shortest duration that the tool's speed, the joints and the driver's gates allow.

    Returns:
        The timed plan, or the refusal of the first step that a gate refuses in any time.
    """
    units = units_of(driver, plan.joints)
    seconds = max(LEAST_S, PEAK * plan.length_m / speed_m_s)
    joint, least_s = _least_s(driver, plan, units)
    if least_s > max(seconds * LONGEST_STRETCH, LONGEST_S / LONGEST_STRETCH) or least_s > LONGEST_S:
        return refusals.too_slow_there(joint, least_s)
    steps = max(1, math.ceil(max(seconds, least_s) / period_s - 1e-9))
    while True:
        refusal = next((each for each in _check(driver, plan, units, steps, reading, period_s) if each), None)
        if refusal is None:
            return TimedPlan(plan, steps)
        steps = math.ceil(steps * STRETCH)
        if refusal.code not in TOO_FAST or steps * period_s > LONGEST_S:
            return refusal.about(MOVE_TO)


def motion_of(driver: Driver, timed: TimedPlan, reading: RobotReading, period_s: float) -> Motion | Refused:
    """Return the motion from the present position of the robot.

    The joints may have drifted since the plan was made. The difference is blended out along the motion.
    """
    plan, steps = timed
    units = units_of(driver, plan.joints)
    drift = units.rad(reading.observation.position) - plan.waypoints[0]
    farthest = int(np.abs(drift).argmax())
    if not abs(drift[farthest]) <= MOVED_RAD:
        return refusals.moved_meanwhile(plan.joints[farthest])
    period_rad = [driver.table[axis].speed / abs(scale) * period_s for axis, _, scale in zip(*units, strict=True)]
    ahead = np.abs(units.rad(reading.target) - units.rad(reading.observation.position))

    def action(step: int) -> dict[str, float]:
        return _action(plan, units, step / steps, drift)

    apart = bool((ahead > period_rad).any())
    return Motion(MOVE_TO, period_s, steps, action, keeps=True, begins_apart=apart)


def _action(plan: PosePlan, units: Units, share: float, drift: Array | None = None) -> dict[str, float]:
    covered = 1.0 if share >= 1 else minimum_jerk(share)
    rad = along(plan.waypoints, covered)
    if drift is not None:
        rad = rad + drift * (1 - covered)
    return dict(zip(plan.joints, units.values(rad), strict=True))


def _least_s(driver: Driver, plan: PosePlan, units: Units) -> tuple[str, float]:
    """Return the joint that needs most time at its top speed, and that time in s."""
    rows = np.array([along(plan.waypoints, minimum_jerk(number / SAMPLES)) for number in range(SAMPLES + 1)])
    per_share = np.abs(np.diff(rows, axis=0)).max(axis=0) * SAMPLES
    speeds = SPEED_SHARE * np.array([driver.table[axis].speed for axis in units.axes]) / np.abs(units.scale)
    needed = per_share / speeds
    slowest = int(needed.argmax())
    return plan.joints[slowest], float(needed[slowest])


def _check(
    driver: Driver, plan: PosePlan, units: Units, steps: int, reading: RobotReading, period_s: float
) -> Iterator[Refused | None]:
    """Check each step with the driver's gates, as if the robot followed without delay."""
    state = state_of(reading, period_s)
    before: Mapping[str, float] = _action(plan, units, 0.0)
    for step in range(1, steps + 1):
        then = _action(plan, units, step / steps)
        yield _refuse_step(driver, before, then, state)
        before = then


def _refuse_step(
    driver: Driver, before: Mapping[str, float], then: Mapping[str, float], state: GateState
) -> Refused | None:
    reached = arrived(driver, before, state)
    if isinstance(reached, Refused):
        return reached
    accepted = refuse_action(driver, then, reached)
    return accepted if isinstance(accepted, Refused) else None


__all__ = ["TimedPlan", "limits_of", "motion_of", "time_plan", "units_of"]
