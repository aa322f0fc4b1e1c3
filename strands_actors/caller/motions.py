"""Plan a motion in a time: joints that reach their targets after so many seconds, or speeds that are
held for so many.

Pure: no clock, no I/O. A plan is refused before anything moves when the robot could not follow it.
What it allows is asked of the robot's own gates, at its end, and at the first, the fastest and the last step.

A joint goes from where it is measured along a minimum-jerk path. The path is counted in control
periods, not in seconds of a clock: a busy computer lengthens a motion, it never makes a step larger.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from msgspec.structs import replace

from strands_actors.contract.axis import AxisMode, finite
from strands_actors.contract.axis_gates import unit_of
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason
from strands_actors.contract.shown import shown
from strands_actors.contract.wire import Observation
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.actions import plain, refuse_shape

PEAK = 1.875
"""Top speed of a minimum-jerk path, as a multiple of its mean speed."""
LONGEST_S = 600.0
"""Longest motion that may be asked for. A longer one is more likely milliseconds than a wish."""
LONGEST_HELD_S = 30.0
"""Longest time for which a speed is held: a base that is forgotten must not drive for minutes."""
CHUNK = 32
"""Actions that are handed out at once."""
MOVE_TO = "move_to"
"""The verb of a motion in a time."""
STRETCH = 1.1
"""By so much a path is lengthened, again and again, until the robot's gates let it pass."""

TOO_FAST = frozenset({Code.TOO_FAST, Code.RUNS_AHEAD})
"""Codes of refusals that more time mends."""


class Motion(NamedTuple):
    """A planned motion. ``action`` gives the command of a step, 1 to ``n_steps``."""

    verb: str
    period_s: float
    n_steps: int
    action: Callable[[int], dict[str, float]]
    keeps: bool = False
    """Whether its last step stands afterwards, as a single command does."""
    begins_apart: bool = False
    """Whether an earlier target is still far from where the robot is. It has to be held first."""

    @property
    def seconds(self) -> float:
        return self.n_steps * self.period_s


class Steps:
    """A motion as a policy: it hands out its actions in their order, and the last one after them."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self._step = 0

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        first, self._step = self._step + 1, self._step + CHUNK
        motion = self._motion
        return [motion.action(min(step, motion.n_steps)) for step in range(first, self._step + 1)]


class Seen(NamedTuple):
    """What is known of the robot when a motion is planned."""

    observation: Observation
    target: tuple[float, ...]
    now_ns: int


def refuse_seconds(verb: str, name: str, seconds: object, longest_s: float) -> Refused | None:
    """Refuse what is not a time that a motion may take."""
    value = finite(seconds)
    if value is not None and 0 < value <= longest_s:
        return None
    given, limit = shown(seconds), f"above 0, at most {longest_s:g}"
    return Refused(Code.BAD_TIME, f"{name} is {given}", f"give seconds, {limit}", given, limit, verb=verb)


def refuse_targets(driver: Driver, targets: object) -> Refused | None:
    """Refuse what ``move_to`` cannot take of this robot, whatever its state is."""
    if driver.axes and not any(is_place(driver, at) for at in range(len(driver.axes))):
        why = f"{driver.robot} has no joints that go to a target"
        return Refused(Code.NO_POSITIONS, why, "use send_action(), or move(..., duration_s=)", verb=MOVE_TO)
    late = driver.fallbacks[Reason.POLICY]
    if driver.timing.oneshot_ttl_s is not None and not driver.energised(late):
        why = f"{driver.robot} keeps no pose by itself: when its commands end it goes to {late}"
        remedy = "use run_policy() with a policy that keeps its pose afterwards, too"
        return Refused(Code.KEEPS_NO_POSE, why, remedy, verb=MOVE_TO)
    refusal = refuse_shape(targets)
    if refusal is not None:
        return refusal.about(MOVE_TO)
    assert isinstance(targets, Mapping)
    speeds = {axis.key for axis in driver.table if axis.mode is AxisMode.VELOCITY}
    for name, value in targets.items():
        if str(name).removesuffix(".pos") in speeds:
            why = f"{shown(name)} is a speed, and has no target to reach"
            remedy = "give joints here, and speeds to move(..., duration_s=) or send_action()"
            return Refused(Code.A_SPEED, why, remedy, shown(name), "joints", verb=MOVE_TO)
        if isinstance(value, Mapping):
            why = f"{shown(name)} is {shown(value)}"
            return Refused(
                Code.NOT_FINITE, why, "give a number for each joint", shown(value), "a number", verb=MOVE_TO
            )
    return None


def plan_move(
    driver: Driver,
    targets: Mapping[str, Any],
    seconds: float,
    seen: Seen,
    period_s: float,
    may_take_longer: bool = False,
) -> Motion | Refused:
    """Plan a minimum-jerk motion of the named joints, from where they are measured to ``targets``.

    Args:
        driver: The robot's.
        targets: By joint, in the driver's units.
        seconds: How long the motion takes.
        seen: The robot's state.
        period_s: The control period.
        may_take_longer: Take the time that the slowest joint needs. False: refuse.

    Returns:
        The motion, or a refusal that names what the robot would accept: the least seconds, a range.
    """
    state = state_of(seen, period_s)
    parsed = driver.parse(plain(targets), state)
    if isinstance(parsed, Refused):
        return parsed.about(MOVE_TO)
    ends = {at: parsed.values[at] for at in parsed.named}
    measured = seen.observation.position
    for at in ends:
        key = driver.axes[at]
        if not math.isfinite(measured[at]):
            why = f"where {key} is, is not known"
            remedy = "use send_action(), which says how the robot goes there"
            return Refused(Code.UNKNOWN_POSE, why, remedy, key, verb=MOVE_TO)
    refusal = _refuse_end(driver, parsed, state)
    if refusal is not None:
        return refusal.about(MOVE_TO)
    starts = {at: measured[at] for at in ends}
    steps = max(1, math.ceil(seconds / period_s - 1e-9))
    slowest, least = _least_steps(driver, starts, ends, period_s)
    refusal = _refuse_steps(driver, starts, ends, state, max(steps, least))
    if refusal is not None and refusal.code not in TOO_FAST:
        return refusal.about(MOVE_TO)
    while refusal is not None:
        least = math.ceil(max(steps, least) * STRETCH)
        if least * period_s > LONGEST_S:
            return refusal.about(MOVE_TO)
        refusal = _refuse_steps(driver, starts, ends, state, least)
        if refusal is not None and refusal.code not in TOO_FAST:
            return refusal.about(MOVE_TO)
    if steps < least and not may_take_longer:
        return _refuse_time(driver, slowest, starts, ends, seconds, least * period_s).about(MOVE_TO)
    steps = max(steps, least)
    apart = any(abs(seen.target[at] - start) > _speed(driver, at) * period_s for at, start in starts.items())
    names = {at: driver.axes[at] for at in ends}

    def action(step: int) -> dict[str, float]:
        return {names[at]: _between(starts[at], ends[at], step / steps) for at in names}

    return Motion(MOVE_TO, period_s, steps, action, keeps=True, begins_apart=apart)


def plan_hold(
    driver: Driver, verb: str, action: Mapping[str, Any], seconds: float, seen: Seen, period_s: float
) -> Motion | Refused:
    """Plan to send ``action`` again and again for so long, and a zero of every speed in it last."""
    state = state_of(seen, period_s)
    refusal = refuse_action(driver, plain(action), state)
    if isinstance(refusal, Refused):
        return refusal.about(verb)
    zero = {driver.axes[at]: driver.table[at].rest for at in refusal.named if not is_place(driver, at)}
    steps = max(1, math.ceil(seconds / period_s - 1e-9)) + 1
    held = plain(action)
    return Motion(verb, period_s, steps, lambda step: held if step < steps or not zero else held | zero)


def minimum_jerk(share: float) -> float:
    """Return how much of the way is done after a share of the time: at rest, and without
    acceleration, at both ends."""
    return share**3 * (10 - 15 * share + 6 * share**2)


def _between(start: float, end: float, share: float) -> float:
    return end if share >= 1 else start + (end - start) * minimum_jerk(share)


def is_place(driver: Driver, at: int) -> bool:
    """Return whether an axis goes to a target. A driver without a table has no other axes."""
    return not driver.table or driver.table[at].mode is AxisMode.POSITION


def _speed(driver: Driver, at: int) -> float:
    return driver.table[at].speed if driver.table else math.inf


def _least_steps(
    driver: Driver, starts: Mapping[int, float], ends: Mapping[int, float], period_s: float
) -> tuple[int, int]:
    """Return which axis needs most time at its own top speed, and in how many periods it gets there."""
    needed = {at: PEAK * abs(end - starts[at]) / _speed(driver, at) for at, end in ends.items()}
    slowest = max(needed, key=lambda at: needed[at])
    return slowest, max(1, math.ceil(needed[slowest] / period_s - 1e-9))


def _refuse_end(driver: Driver, end: Candidate, state: GateState) -> Refused | None:
    """Ask the robot's gates about the end of a path, as seen from where the robot is: a range lets a
    joint that is past its end stay there, and one that is not does not go there."""
    found = (gate(end, state) for gate in driver.gates)
    return next((refusal for refusal in found if refusal is not None and refusal.code not in TOO_FAST), None)


def _refuse_steps(
    driver: Driver, starts: Mapping[int, float], ends: Mapping[int, float], state: GateState, steps: int
) -> Refused | None:
    """Ask the robot's gates about the first, the fastest and the last step of a path."""
    for step in dict.fromkeys((1, steps // 2 + 1, steps)):
        before, then = (
            {driver.axes[at]: _between(starts[at], end, at_step / steps) for at, end in ends.items()}
            for at_step in (step - 1, step)
        )
        here = arrived(driver, before, state)
        if isinstance(here, Refused):
            return here
        refused = refuse_action(driver, then, here)
        if isinstance(refused, Refused):
            return refused
    return None


def arrived(driver: Driver, action: Mapping[str, float], state: GateState) -> GateState | Refused:
    """Return the state of a robot that has reached ``action``."""
    parsed = driver.parse(action, state)
    if isinstance(parsed, Refused):
        return parsed
    position = list(state.observation.position)
    for at in parsed.named:
        position[at] = parsed.values[at]
    observation = replace(state.observation, position=tuple(position))
    return replace(state, observation=observation, target=parsed.values)


def refuse_action(driver: Driver, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
    """Return what the robot's gates let pass of ``action``, or why they do not."""
    parsed = driver.parse(action, state)
    if isinstance(parsed, Refused):
        return parsed
    for gate in driver.gates:
        refusal = gate(parsed, state)
        if refusal is not None:
            return refusal
    return parsed


def _refuse_time(
    driver: Driver,
    slowest: int,
    starts: Mapping[int, float],
    ends: Mapping[int, float],
    seconds: float,
    least_s: float,
) -> Refused:
    key, unit = driver.axes[slowest], unit_of(driver.table[slowest]) if driver.table else ""
    way, least = abs(ends[slowest] - starts[slowest]), f"{math.ceil(least_s * 100 - 1e-6) / 100:g}"
    why = f"{key} has {way:.4g}{unit} to go, too far for {seconds:g} s"
    return Refused(Code.TOO_FAST, why, f"give seconds={least} or more", f"{seconds:g}", least)


def state_of(seen: Seen, period_s: float) -> GateState:
    """Return what a gate would look at, had every reading that there is been taken just now."""
    stamps: Sequence[int] = seen.observation.stamp_ns
    fresh = tuple(seen.now_ns if stamp else 0 for stamp in stamps)
    observation = replace(seen.observation, t_ns=seen.now_ns, stamp_ns=fresh)
    before_ns = seen.now_ns - round(period_s * NS)
    return GateState(seen.now_ns, observation, seen.target, before_ns, True, period_s)
