"""Conditions and gates of an xArm. They refuse a setpoint before it reaches the controller.

Every gate is a pure function of the setpoint and the robot's state. A gate never changes a value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import outside_reported_range, past_ranges, stale
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.step_gates import refuse_lead, refuse_step
from strands_actors.kernel.messages import Refused

from . import refusals
from .arms import Arm
from .protocol import Mode, State

LEAD_S = 0.1
"""A target may be ahead of the measured position by as far as the joint turns in this time, in seconds. After
something has blocked the arm, servo mode moves it to the target at full speed [assumed: no arm lags further behind
while it moves freely]."""

Axes = Sequence[Axis]


def all_gates(arm: Arm, axes: Axes, period_s: float, state_ttl_s: float) -> tuple[GateCheck, ...]:
    """Return the gates in the order in which they check a setpoint. The first one that refuses it gives the
    reason."""
    return stale(axes, state_ttl_s), past_own_range(arm, axes), too_fast(arm, axes, period_s), runs_ahead(arm, axes)


# -- conditions of the robot, checked before and during a motion


def error_free(observation: Observation, now_ns: int) -> Refused | None:
    error = _sensor(observation, "error")
    return None if error == 0 else refusals.controller_error(error)


def running(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse to move an arm that is paused or stopped by any client. The arm does not continue by itself."""
    state = _sensor(observation, "state")
    return None if state in (State.MOVING, State.READY) else refusals.not_running(state)


def in_servo_mode(observation: Observation, now_ns: int) -> Refused | None:
    mode = _sensor(observation, "mode")
    return None if mode == Mode.SERVO else refusals.wrong_mode(mode)


CONDITIONS = (
    Condition(error_free, always=True),
    Condition(running, always=True, on_resume=OnResume.ARM_ANEW),
    Condition(in_servo_mode, always=True, on_resume=OnResume.ARM_ANEW),
)


# -- gates, checked for each setpoint


def past_own_range(arm: Arm, axes: Axes) -> GateCheck:
    """Refuse a target outside the range of the arm's type. The observation has this range. Without a range in the
    observation, accept only targets that are inside the ranges of all types."""
    joints = zip(*(arm_type.range_rad for arm_type in arm.types), strict=True)
    of_all = past_ranges(axes, [(max(low for low, _ in ends), min(high for _, high in ends)) for ends in joints])
    return outside_reported_range(axes, "range_low_rad", "range_high_rad", fallback=of_all)


def speed_limit(arm: Arm, state: GateState) -> float:
    """Return the joint speed limit in rad/s: the lower one of the controller's limit, if it is known, and the
    table's limit."""
    reported = state.observation.sensors.get("speed_limit_rad_s", (math.nan,))[0]
    return min(reported, arm.speed_rad_s) if reported > 0.0 else arm.speed_rad_s


def too_fast(arm: Arm, axes: Axes, period_s: float) -> GateCheck:
    """Refuse a step from the last *commanded* target that is larger than a joint can turn in one control period.

    Servo mode has no speed setting. The arm moves to each target at full speed, even if targets come rarely.
    """

    def too_fast(candidate: Candidate, state: GateState) -> Refused | None:
        return refuse_step(axes, candidate, state, state.target, [speed_limit(arm, state)] * len(axes), period_s)

    return too_fast


def runs_ahead(arm: Arm, axes: Axes) -> GateCheck:
    """Refuse a target that is too far ahead of the measured position: the arm follows too slowly, or something
    blocks it."""

    def runs_ahead(candidate: Candidate, state: GateState) -> Refused | None:
        return refuse_lead(axes, candidate, state, [speed_limit(arm, state)] * len(axes), LEAD_S)

    return runs_ahead


def _sensor(observation: Observation, name: str) -> int | None:
    row = observation.sensors.get(name)
    return round(row[0]) if row else None
