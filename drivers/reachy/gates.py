"""Checks that refuse a command before it reaches the daemon, because the daemon accepts any number.

Pure; nothing is ever clipped.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from strands_actors.contract.axis import Axis, finite, parse_action
from strands_actors.contract.axis_gates import past_range, show, stale
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume
from strands_actors.contract.refusals import not_finite
from strands_actors.contract.shown import SHOWN
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from . import refusals
from .protocol import BODY, MODES, YAW

DURATION = "duration"
LOOK = ("look_x", "look_y", "look_z")
"""Keys of a point to look at, in metres from the head at rest: to the front, to the left, up."""

SHORTEST_S, LONGEST_S = 0.1, 10.0
"""Limits of the duration of a move."""

AT_ONCE_S = 0.03
"""A step that every axis does in this time at full speed is sent as a target, without a move. A stream has
such small steps."""

EASE = 0.5
"""Speed of a move without a duration, as a share of full speed [assumed]."""

NEAREST_M = 0.05
"""A point nearer than this has no usable direction [assumed]."""

_ROUNDING = 1e-9


def parse(
    action: Mapping[str, object], robot: str, axes: Sequence[Axis], index: Mapping[str, int], state: GateState
) -> Candidate | Refused:
    """Parse an action. Return the target of all axes, followed by the duration of the move in seconds; 0 sends
    a plain target without a move."""
    requested = dict(action)
    duration = requested.pop(DURATION, None)
    if any(name in requested for name in LOOK):
        refusal = _look(requested)
        if refusal is not None:
            return refusal
    parsed = parse_action(requested, robot, axes, index, state.target[: len(axes)])
    if isinstance(parsed, Refused):
        return _with_all_keys(parsed)
    values, named = parsed
    if duration is None:
        full_s = max(_full_speed_s(values, axes, state.observation))
        at_once = full_s <= AT_ONCE_S
        return Candidate((*values, 0.0 if at_once else max(SHORTEST_S, full_s / EASE)), named)
    duration_s = finite(duration)
    if duration_s is None:
        shown = str(duration)[:SHOWN]
        return not_finite(DURATION, shown, shown)
    if not SHORTEST_S <= duration_s <= LONGEST_S:
        return refusals.duration_outside_limits(DURATION, duration_s, SHORTEST_S, LONGEST_S)
    return Candidate((*values, duration_s), named)


def all_gates(axes: Sequence[Axis], state_ttl_s: float, yaw_deg: float) -> tuple[GateCheck, ...]:
    """Return the gates (checks of a command) in the order in which they are applied. The first refusal is reported
    to the caller."""
    own = past_range(axes), asleep(axes), twisted(yaw_deg), too_fast(axes)
    return stale(axes, state_ttl_s), would_be_heeded, *own


def asleep(axes: Sequence[Axis]) -> GateCheck:
    """Refuse to move one axis of the head while another would stay outside its range, as in the sleeping pose.
    The daemon would not move the head and would report no error."""

    def asleep(candidate: Candidate, state: GateState) -> Refused | None:
        if not any(index < BODY for index in candidate.named):
            return None
        for value, axis in zip(candidate.values[:BODY], axes, strict=False):
            if not axis.low - _ROUNDING <= value <= axis.high + _ROUNDING:
                low, high = show(axis.low, axis.unit), show(axis.high, axis.unit)
                return refusals.asleep(axis.key, show(value, axis.unit), low, high, axis.unit)
        return None

    return asleep


def twisted(yaw_deg: float) -> GateCheck:
    """Refuse a yaw of the head that differs too much from the yaw of the body."""

    def twisted(candidate: Candidate, state: GateState) -> Refused | None:
        head_yaw, body_yaw = candidate.values[YAW], candidate.values[BODY]
        apart = head_yaw - body_yaw
        if abs(apart) <= yaw_deg + _ROUNDING or not {YAW, BODY} & set(candidate.named):
            return None
        return refusals.twisted(show(head_yaw, "deg"), show(body_yaw, "deg"), show(apart, "deg"), yaw_deg)

    return twisted


def too_fast(axes: Sequence[Axis]) -> GateCheck:
    """Refuse a move whose duration is too short for an axis to reach its target from its present position."""

    def too_fast(candidate: Candidate, state: GateState) -> Refused | None:
        duration_s = candidate.values[len(axes)]
        if duration_s == 0.0:
            # Without a duration the step is small: ``parse`` has checked that.
            return None
        needed = _full_speed_s(candidate.values, axes, state.observation)
        slowest = max(range(len(axes)), key=lambda index: needed[index])
        if needed[slowest] <= duration_s + _ROUNDING:
            return None
        least = math.ceil(needed[slowest] * 100) / 100
        axis = axes[slowest]
        step = abs(candidate.values[slowest] - state.observation.position[slowest])
        return refusals.too_fast(axis.key, show(step, axis.unit), axis.unit, duration_s, least)

    return too_fast


def motors_on(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse commands while the motors have no torque. The daemon would accept them and report success."""
    reading = observation.sensors.get("motor_mode")
    mode = "in an unknown mode" if reading is None else MODES[round(reading[0])]
    return None if mode == "enabled" else refusals.motors_off(mode)


def heeded(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse commands after the daemon has ignored a command of ours."""
    return refusals.ignored() if any(observation.sensors.get("ignored", ())) else None


def would_be_heeded(candidate: Candidate, state: GateState) -> Refused | None:
    """Refuse commands while another client's move runs. The daemon ignores targets and moves until that move
    ends."""
    return refusals.ignored() if any(state.observation.sensors.get("others_move", ())) else None


CONDITIONS = (Condition(motors_on, on_resume=OnResume.STAY_ARMED), Condition(heeded))


def direction(x: float, y: float, z: float) -> tuple[float, float]:
    """Return the pitch and yaw at which the head looks at a point, in degrees. Pitch is positive downwards, yaw
    to the left."""
    return math.degrees(math.atan2(-z, math.hypot(x, y))), math.degrees(math.atan2(y, x))


def _look(requested: dict[str, object]) -> Refused | None:
    """Replace the point to look at in an action by the head pose that looks there."""
    keys = ", ".join(LOOK)
    point = [finite(requested.pop(name, None)) for name in LOOK]
    if both := [name for name in ("head_pitch", "head_yaw") if {name, f"{name}.pos"} & requested.keys()]:
        return refusals.point_and_angle(keys, both[0])
    x, y, z = point
    if x is None or y is None or z is None:
        return refusals.point_not_finite(keys, str(point)[:SHOWN])
    distance_m = math.hypot(x, y, z)
    if distance_m < NEAREST_M:
        return refusals.point_too_near(str(point), distance_m, NEAREST_M)
    requested["head_pitch"], requested["head_yaw"] = direction(x, y, z)
    return None


def _full_speed_s(values: Sequence[float], axes: Sequence[Axis], observation: Observation) -> list[float]:
    """Return for each axis the seconds that it needs at full speed from its present position to the target; 0
    if its position is unknown."""
    steps = [
        abs(value - position) / axis.speed
        for value, position, axis in zip(values, observation.position, axes, strict=False)
    ]
    return [step if math.isfinite(step) else 0.0 for step in steps]


def _with_all_keys(refusal: Refused) -> Refused:
    if refusal.code not in (Code.UNKNOWN_JOINT, Code.EMPTY):
        return refusal
    return refusals.with_further_keys(refusal, DURATION, ", ".join(LOOK))
