"""What is refused before it reaches the controller. Every gate is a pure function of the candidate and the state;
nothing is ever clipped."""

from __future__ import annotations

import math
from collections.abc import Mapping

from strands_actors.contract.axis import finite
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, Observation
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from .arms import JOINTS, Arm
from .protocol import MOVABLE_SAFETY, RobotMode, RuntimeState, robot_mode_name, safety_mode_name

CONTROL_HZ = 125.0
CONTROL_S = 1 / CONTROL_HZ
WATCHDOG_HZ = 10.0
"""Of the controller: so often at least it wants to hear from us while our script runs."""

LOOKAHEAD_S = 0.1
"""servoJ spreads a step over this: a slower stream may not step further than the joint turns meanwhile."""

_ROUNDING = 1e-9

_PAUSED = (RuntimeState.PAUSED, RuntimeState.PAUSING)
_RUNNING = (RuntimeState.PLAYING, *_PAUSED)

_UNLOCK = {
    "PROTECTIVE_STOP": "look at the arm, then unlock it on the pendant",
    "SAFEGUARD_STOP": "close the safeguard",
}


def all_gates(arm: Arm, state_ttl_s: float, period_s: float = CONTROL_S) -> tuple[GateCheck, ...]:
    """In the order in which they are asked: the first that refuses answers."""
    return (stale(state_ttl_s), paused, past_range(arm), too_fast(arm, period_s))


def parse(action: Mapping[str, object], robot: str, state: GateState) -> Candidate | Refused:
    """Names and radians to a whole target. ``x`` and ``x.pos`` name the same joint: not both at once."""
    keys = ", ".join(JOINTS)
    if not action:
        return Refused("empty", "move: the action names no joint", f"use {keys}", "{}", keys)
    target = list(state.target)
    named: list[int] = []
    for key, value in action.items():
        name = key.removesuffix(".pos") if isinstance(key, str) else ""
        if name not in JOINTS:
            shown = str(key)[:40] or "''"
            return Refused("unknown_joint", f"move: {shown} is not a joint of {robot}", f"use {keys}", shown, keys)
        at = JOINTS.index(name)
        if at in named:
            both = f"{name} and {name}.pos"
            return Refused("both_spellings", f"move: {both} are both given", "send one of them", both, name)
        number = finite(value)
        if number is None:
            shown = str(value)[:40]
            return Refused("not_finite", f"move: {name} is {shown}", "send a finite number", shown, "radians")
        target[at] = number
        named.append(at)
    return Candidate(tuple(target), tuple(named))


def refuse_modes(robot: int, safety: int) -> Refused | None:
    """Whether the arm could move at all, by the controller's modes. Arming asks the same."""
    if robot != RobotMode.RUNNING:
        name = robot_mode_name(robot)
        return Refused(
            "robot_mode", f"move: robot is {name}", "power on and release brakes", name, robot_mode_name(7)
        )
    if safety not in MOVABLE_SAFETY:
        name = safety_mode_name(safety)
        remedy = _UNLOCK.get(name.split()[0], "clear it on the pendant")
        return Refused("safety_mode", f"move: {name}", remedy, name, "NORMAL (1) or REDUCED (2)")
    return None


# -- what must be true for a motion to begin, and to go on


def modes(observation: Observation, now_ns: int) -> Refused | None:
    robot = _sensor(observation, "robot_mode", RobotMode.NO_CONTROLLER)
    return refuse_modes(robot, _sensor(observation, "safety_mode", 0))


def program(observation: Observation, now_ns: int) -> Refused | None:
    """The control script runs, and was not stopped since the robot was armed: motion never goes on by itself after
    a protective stop, or when the controller's watchdog has ended the script."""
    runs = _sensor(observation, "runtime_state", 0)
    if _sensor(observation, "control", 0) != 1 or runs not in _RUNNING:
        return Refused("program", "move: control script is not running", "stop(), then resume()", limit="PLAYING")
    return None


CONDITIONS = (Condition(modes), Condition(program))


# -- of one setpoint


def paused(candidate: Candidate, state: GateState) -> Refused | None:
    runs = _sensor(state.observation, "runtime_state", 0)
    if runs in _PAUSED or state.observation.sensors.get("speed_scaling", (0.0,))[0] <= 0.0:
        return Refused("paused", "move: the program is paused", "play it on the pendant, or raise the speed slider")
    return None


def stale(ttl_s: float) -> GateCheck:
    def stale(candidate: Candidate, state: GateState) -> Refused | None:
        age_ns = state.now_ns - min(state.observation.stamp_ns, default=0)
        if age_ns > ttl_s * NS or not all(math.isfinite(rad) for rad in candidate.values):
            age = f"{age_ns / 1e6:.0f} ms"
            return Refused(
                "stale",
                f"move: the controller's clock stands still for {age}",
                "check its network; it is back by itself as soon as it answers",
                age,
                f"{ttl_s * 1e3:.0f} ms",
            )
        return None

    return stale


def past_range(arm: Arm) -> GateCheck:
    reach = arm.reach_rad

    def past_range(candidate: Candidate, state: GateState) -> Refused | None:
        for at in candidate.named:
            rad, most = candidate.values[at], reach[at]
            # not (a <= b) rather than b < a: a NaN is refused too
            if not abs(rad) <= most + _ROUNDING:
                inner = math.floor(most * 1e4) / 1e4  # what the text allows is allowed
                return Refused(
                    "past_travel",
                    f"move: {JOINTS[at]} {rad:.4g} rad is past {math.copysign(inner, rad):.4f}",
                    f"stay within -{inner:.4f}..{inner:.4f} rad",
                    f"{rad:.4g}",
                    f"-{inner:.4f}..{inner:.4f}",
                )
        return None

    return past_range


def too_fast(arm: Arm, own_period_s: float = CONTROL_S) -> GateCheck:
    """From the last *commanded* target, as far as the joint turns in one period of the stream. A command on its own
    is one period of whoever sends them (``own_period_s``): servoJ has no speed, a far target would be a blow."""
    speed = arm.speed_rad_s

    def too_fast(candidate: Candidate, state: GateState) -> Refused | None:
        period_s = min(state.period_s, LOOKAHEAD_S) if state.stream else own_period_s
        for at in candidate.named:
            step = abs(candidate.values[at] - state.target[at])
            allowed = speed[at] * period_s
            if not step <= allowed + _ROUNDING:
                shown = math.floor(allowed * 1e5) / 1e5
                return Refused(
                    "too_fast",
                    f"move: {JOINTS[at]} steps {step:.5g} rad, limit {shown:.5g} at {1 / period_s:.4g} Hz",
                    f"step at most {shown:.5g} rad",
                    f"{step:.5g}",
                    f"{shown:.5g}",
                )
        return None

    return too_fast


def _sensor(observation: Observation, name: str, missing: int) -> int:
    row = observation.sensors.get(name)
    return round(row[0]) if row else missing
