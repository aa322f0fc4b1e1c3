"""What is refused before it reaches the arm. Every gate and condition is pure; nothing is ever clipped.

A target is one position for each joint, radians, and behind them over how many seconds the wire spreads it. A target
without that is a measured position: nothing was accepted since the robot was armed or held.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from strands_actors.drivers.common.numbers import finite
from strands_actors.runtime.clock import NS
from strands_actors.runtime.contract import Candidate, Condition, GateCheck, GateState, Observation
from strands_actors.runtime.messages import Refused

from .protocol import JOINTS, ClientMode, ControlMode, Drive, Overlay, Quality, State, name_of
from .robots import Arm

LONGEST_STEP_S = 0.1
"""A slower stream may not step further than a joint turns meanwhile."""

_ROUNDING = 1e-9
_ON_THE_PENDANT = "clear it on the pendant"


def parse(action: Mapping[str, object], arm: Arm, oneshot_s: float, state: GateState) -> Candidate | Refused:
    """Return the whole target of names and radians. ``x`` and ``x.pos`` name the same joint: not both at once.
    ``oneshot_s``: over how long a command on its own is spread."""
    keys = ", ".join(arm.axes)
    if not action:
        return Refused("empty", "move: the action names no joint", f"use {keys}", "{}", keys)
    target = list(last_target(state))
    named: list[int] = []
    for key, value in action.items():
        name = key.removesuffix(".pos") if isinstance(key, str) else ""
        if name not in arm.axes:
            shown = str(key)[:40] or "''"
            why = f"move: {shown} is not a joint of {arm.name}"
            return Refused("unknown_joint", why, f"use {keys}", shown, keys)
        at = arm.axes.index(name)
        if at in named:
            both = f"{name} and {name}.pos"
            return Refused("both_spellings", f"move: {both} are both given", "send one of them", both, name)
        number = finite(value)
        if number is None:
            shown = str(value)[:40]
            return Refused("not_finite", f"move: {name} is {shown}", "send a finite number", shown, "radians")
        target[at] = number
        named.append(at)
    return Candidate((*target, span_s(state, oneshot_s)), tuple(named))


def span_s(state: GateState, oneshot_s: float) -> float:
    """Return over how long a step may be spread: the period of its stream."""
    return min(state.period_s, LONGEST_STEP_S) if state.stream else oneshot_s


def last_target(state: GateState) -> tuple[float, ...]:
    """Return the position from which a step is counted: the last target, or what the arm is told to hold. Its
    measured position lags behind that: a joint that is not named would be moved back by it."""
    if len(state.target) == JOINTS:
        return state.observation.sensors.get("commanded_rad", state.target)
    return state.target[:JOINTS]


# -- what must be true for a motion to begin, and to go on


def conditions(arm: Arm, state_ttl_s: float) -> tuple[Condition, ...]:
    """In the order in which they are asked: the first that refuses answers."""
    return (stale(state_ttl_s), safety, drives(arm), session, client_mode, control_mode, overlay, quality)


def stale(ttl_s: float) -> Condition:
    limit = f"{ttl_s * 1e3:.0f} ms"

    def stale(observation: Observation, now_ns: int) -> Refused | None:
        age_ns = now_ns - min(observation.stamp_ns, default=0)
        if age_ns <= ttl_ns and all(map(math.isfinite, observation.position)):
            return None
        age = f"{age_ns / 1e6:.0f} ms"
        why = f"move: no FRI message for {age}"
        return Refused("stale", why, "check the controller, its FRI session and the network", age, limit)

    ttl_ns = round(ttl_s * NS)
    return stale


def safety(observation: Observation, now_ns: int) -> Refused | None:
    level = _sensor(observation, "safety_state")
    if level == 0:
        return None
    return Refused("safety", f"move: safety stop, level {level}", _ON_THE_PENDANT, f"{level}", "0")


def drives(arm: Arm) -> Condition:
    def drives(observation: Observation, now_ns: int) -> Refused | None:
        row = observation.sensors.get("drive_state", ())
        if not row:
            return Refused("drives", "move: the state of the drives is not known", _ON_THE_PENDANT, "", "ACTIVE")
        # One number may stand for all joints.
        for key, number in zip(arm.axes, row, strict=False):
            if number != Drive.ACTIVE:
                name = name_of(Drive, round(number))
                return Refused("drives", f"move: drive of {key} is {name}", _ON_THE_PENDANT, name, "ACTIVE")
        return None

    return drives


def session(observation: Observation, now_ns: int) -> Refused | None:
    return _refuse_other(
        observation, "fri_state", State.COMMANDING_ACTIVE, "FRI session", "start the motion on the pendant"
    )


def client_mode(observation: Observation, now_ns: int) -> Refused | None:
    remedy = "let the robot program command positions: ClientCommandMode.POSITION"
    return _refuse_other(observation, "client_mode", ClientMode.POSITION, "FRI client command mode", remedy)


def control_mode(observation: Observation, now_ns: int) -> Refused | None:
    """What the arm does when the session ends is only known of position control."""
    remedy = "use PositionControlMode in the robot program"
    return _refuse_other(observation, "control_mode", ControlMode.POSITION, "control mode", remedy)


def overlay(observation: Observation, now_ns: int) -> Refused | None:
    if _sensor(observation, "overlay") != Overlay.NO_OVERLAY:
        return None
    remedy = "start the robot program's motion again, with the FRI overlay"
    return Refused("overlay", "move: the overlay is lost", remedy, "NO_OVERLAY", "JOINT")


def quality(observation: Observation, now_ns: int) -> Refused | None:
    number = _sensor(observation, "fri_quality")
    if number >= Quality.GOOD:
        return None
    name = name_of(Quality, number)
    remedy = "wait until it is GOOD; check the network and the load of this machine"
    return Refused("quality", f"move: FRI connection quality is {name}", remedy, name, "GOOD")


# -- of one setpoint


def gates(arm: Arm, oneshot_s: float) -> tuple[GateCheck, ...]:
    """In the order in which they are asked: the first that refuses answers."""
    return (past_range(arm), too_fast(arm, oneshot_s))


def past_range(arm: Arm) -> GateCheck:
    def past_range(candidate: Candidate, state: GateState) -> Refused | None:
        for at in candidate.named:
            joint, rad = arm.joints[at], candidate.values[at]
            # not (a <= b) rather than b < a: a NaN is refused too
            if not abs(rad) <= joint.reach_rad + _ROUNDING:
                inner = math.floor(joint.reach_rad * 1e4) / 1e4  # what the text allows is allowed
                return Refused(
                    "past_travel",
                    f"move: {joint.key} {rad:.4g} rad is past {math.copysign(inner, rad):.4f}",
                    f"stay within -{inner:.4f}..{inner:.4f} rad",
                    f"{rad:.4g}",
                    f"-{inner:.4f}..{inner:.4f}",
                )
        return None

    return past_range


def too_fast(arm: Arm, oneshot_s: float) -> GateCheck:
    """From the last target, as far as a joint turns in one period of the stream; a command on its own is one period
    of the control loop."""
    speed = arm.speed_rad_s

    def too_fast(candidate: Candidate, state: GateState) -> Refused | None:
        period_s, before = span_s(state, oneshot_s), last_target(state)
        for at in candidate.named:
            step = abs(candidate.values[at] - before[at])
            allowed = speed[at] * period_s
            if not step <= allowed + _ROUNDING:
                shown = math.floor(allowed * 1e5) / 1e5
                return Refused(
                    "too_fast",
                    f"move: {arm.axes[at]} steps {step:.5g} rad, limit {shown:.5g} at {1 / period_s:.4g} Hz",
                    f"step at most {shown:.5g} rad",
                    f"{step:.5g}",
                    f"{shown:.5g}",
                )
        return None

    return too_fast


def _refuse_other(
    observation: Observation, sensor: str, wanted: State | ClientMode | ControlMode, what: str, remedy: str
) -> Refused | None:
    number = _sensor(observation, sensor)
    if number == wanted:
        return None
    name = name_of(type(wanted), number)
    return Refused(sensor, f"move: {what} is {name}", remedy, name, wanted.name)


def _sensor(observation: Observation, name: str) -> int:
    """Return a number that the controller says; -1 when it does not."""
    row = observation.sensors.get(name)
    return round(row[0]) if row else -1
