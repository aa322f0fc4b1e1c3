"""Plan motions with a duration: joints that reach targets, or speeds that are held.

Pure: no clock, no I/O. If the robot could not follow a plan, the plan is refused before anything moves. The
driver's gates (its checks of range and speed) decide that. They check the end of the motion, and its first,
fastest and last step.

A joint moves from its measured position along a minimum-jerk path. The path is counted in control
periods, not in seconds of a clock. So a busy computer lengthens a motion, and never makes a step
larger.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from msgspec.structs import replace

from strands_actors.contract.axis import AxisMode, finite
from strands_actors.contract.axis_gates import unit_of
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.actions import plain, refuse_shape

from . import refusals

PEAK = 1.875
"""Top speed of a minimum-jerk path, as a multiple of its mean speed."""
LONGEST_S = 600.0
"""Longest duration of a motion. A greater number was probably meant as milliseconds."""
LONGEST_HELD_S = 30.0
"""Longest time for which a speed is held. A forgotten base must not drive for minutes."""
CHUNK = 32
"""Number of actions in a chunk of ``Steps``."""
MOVE_TO = "move_to"
"""The verb of a motion to targets."""
STRETCH = 1.1
"""Factor by which a path is lengthened, repeatedly, until the robot's gates accept it."""

TOO_FAST = frozenset({Code.TOO_FAST, Code.RUNS_AHEAD})
"""Codes of refusals for which a longer motion is the remedy."""


class Motion(NamedTuple):
    """A planned motion.

    Attributes:
        verb: Name of the user's verb.
        period_s: The control period.
        n_steps: Number of control periods of the motion.
        action: Returns the command of a step, 1 to ``n_steps``.
    """

    verb: str
    period_s: float
    n_steps: int
    action: Callable[[int], dict[str, float]]
    keeps: bool = False
    """True if its last setpoint stays in force afterwards, as a single command does."""
    begins_apart: bool = False
    """True if an earlier target is far from the measured position. The robot has to hold first."""

    @property
    def seconds(self) -> float:
        return self.n_steps * self.period_s


class Steps:
    """A motion as a policy. It returns the actions in their order, then repeats the last one."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self._step = 0

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        first, self._step = self._step + 1, self._step + CHUNK
        motion = self._motion
        return [motion.action(min(step, motion.n_steps)) for step in range(first, self._step + 1)]


class RobotReading(NamedTuple):
    """What is known of a robot when a motion is planned: its reading, its present target, and the time."""

    observation: Observation
    target: tuple[float, ...]
    now_ns: int


def refuse_seconds(verb: str, name: str, seconds: object, longest_s: float) -> Refused | None:
    """Return a refusal unless ``seconds`` is a number above 0 and at most ``longest_s``."""
    value = finite(seconds)
    if value is not None and 0 < value <= longest_s:
        return None
    return refusals.bad_time(verb, name, seconds, longest_s)


def refuse_targets(driver: Driver, targets: object) -> Refused | None:
    """Return a refusal of targets that ``move_to`` cannot accept, in any state of this robot."""
    if driver.axes and not any(is_place(driver, index) for index in range(len(driver.axes))):
        return refusals.no_positions(driver.robot).about(MOVE_TO)
    late = driver.fallbacks[Reason.POLICY]
    if driver.timing.oneshot_ttl_s is not None and not driver.energised(late):
        return refusals.keeps_no_pose(driver.robot, late).about(MOVE_TO)
    refusal = refuse_shape(targets)
    if refusal is not None:
        return refusal.about(MOVE_TO)
    assert isinstance(targets, Mapping)
    speeds = {axis.key for axis in driver.table if axis.mode is AxisMode.VELOCITY}
    for name, value in targets.items():
        if str(name).removesuffix(".pos") in speeds:
            return refusals.a_speed(name).about(MOVE_TO)
        if isinstance(value, Mapping):
            return refusals.no_number(name, value).about(MOVE_TO)
    return None


def plan_move(
    driver: Driver,
    targets: Mapping[str, Any],
    seconds: float,
    reading: RobotReading,
    period_s: float,
    may_take_longer: bool = False,
) -> Motion | Refused:
    """Plan a minimum-jerk motion of the named joints, from where they are measured to ``targets``.

    Args:
        driver: The driver of the robot.
        targets: Target by joint, in the driver's units.
        seconds: Duration of the motion.
        reading: The robot's state.
        period_s: The control period.
        may_take_longer: If ``seconds`` is too short for a joint, True takes the time that this joint
            needs, and False refuses.

    Returns:
        The motion, or a refusal that names the shortest accepted time or the accepted range.
    """
    state = state_of(reading, period_s)
    parsed = driver.parse(plain(targets), state)
    if isinstance(parsed, Refused):
        return parsed.about(MOVE_TO)
    ends = {index: parsed.values[index] for index in parsed.named}
    measured = reading.observation.position
    for index in ends:
        if not math.isfinite(measured[index]):
            return refusals.unknown_pose(driver.axes[index]).about(MOVE_TO)
    refusal = _refuse_end(driver, parsed, state)
    if refusal is not None:
        return refusal.about(MOVE_TO)
    starts = {index: measured[index] for index in ends}
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
    apart = any(
        abs(reading.target[index] - start) > _speed(driver, index) * period_s for index, start in starts.items()
    )
    names = {index: driver.axes[index] for index in ends}

    def action(step: int) -> dict[str, float]:
        return {names[index]: _between(starts[index], ends[index], step / steps) for index in names}

    return Motion(MOVE_TO, period_s, steps, action, keeps=True, begins_apart=apart)


def plan_hold(
    driver: Driver, verb: str, action: Mapping[str, Any], seconds: float, reading: RobotReading, period_s: float
) -> Motion | Refused:
    """Plan to send ``action`` repeatedly for ``seconds``, and then zero for each of its speeds."""
    state = state_of(reading, period_s)
    refusal = refuse_action(driver, plain(action), state)
    if isinstance(refusal, Refused):
        return refusal.about(verb)
    zero = {driver.axes[index]: driver.table[index].rest for index in refusal.named if not is_place(driver, index)}
    steps = max(1, math.ceil(seconds / period_s - 1e-9)) + 1
    command = plain(action)
    return Motion(verb, period_s, steps, lambda step: command if step < steps or not zero else command | zero)


def minimum_jerk(share: float) -> float:
    """Return the share of the distance that a minimum-jerk motion has covered after a share of its time.

    Speed and acceleration are zero at both ends.
    """
    return share**3 * (10 - 15 * share + 6 * share**2)


def _between(start: float, end: float, share: float) -> float:
    return end if share >= 1 else start + (end - start) * minimum_jerk(share)


def is_place(driver: Driver, index: int) -> bool:
    """Return True if an axis is commanded by position. A driver without a table of axes has only such axes."""
    return not driver.table or driver.table[index].mode is AxisMode.POSITION


def _speed(driver: Driver, index: int) -> float:
    return driver.table[index].speed if driver.table else math.inf


def _least_steps(
    driver: Driver, starts: Mapping[int, float], ends: Mapping[int, float], period_s: float
) -> tuple[int, int]:
    """Return the axis that needs most time at its top speed, and the number of periods that it needs."""
    needed = {index: PEAK * abs(end - starts[index]) / _speed(driver, index) for index, end in ends.items()}
    slowest = max(needed, key=lambda index: needed[index])
    return slowest, max(1, math.ceil(needed[slowest] / period_s - 1e-9))


def _refuse_end(driver: Driver, end: Candidate, state: GateState) -> Refused | None:
    """Check the end of a path with the driver's gates, from the present state of the robot.

    A joint that is outside its range may stay there, but no other joint may be sent there. Refusals for speed
    are ignored, since the robot does not reach the end in one step.
    """
    answers = (gate(end, state) for gate in driver.gates)
    return next((refusal for refusal in answers if refusal is not None and refusal.code not in TOO_FAST), None)


def _refuse_steps(
    driver: Driver, starts: Mapping[int, float], ends: Mapping[int, float], state: GateState, steps: int
) -> Refused | None:
    """Check the first, the fastest and the last step of a path with the robot's gates."""
    for step in dict.fromkeys((1, steps // 2 + 1, steps)):
        before, then = (
            {driver.axes[index]: _between(starts[index], end, number / steps) for index, end in ends.items()}
            for number in (step - 1, step)
        )
        reached = arrived(driver, before, state)
        if isinstance(reached, Refused):
            return reached
        refused = refuse_action(driver, then, reached)
        if isinstance(refused, Refused):
            return refused
    return None


def arrived(driver: Driver, action: Mapping[str, float], state: GateState) -> GateState | Refused:
    """Return the state that a robot has when it has reached ``action``."""
    parsed = driver.parse(action, state)
    if isinstance(parsed, Refused):
        return parsed
    position = list(state.observation.position)
    for index in parsed.named:
        position[index] = parsed.values[index]
    observation = replace(state.observation, position=tuple(position))
    return replace(state, observation=observation, target=parsed.values)


def refuse_action(driver: Driver, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
    """Return the targets of ``action``, or the refusal of the robot's gates (its checks of range and speed)."""
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
    distance, least = abs(ends[slowest] - starts[slowest]), f"{math.ceil(least_s * 100 - 1e-6) / 100:g}"
    return refusals.too_far(key, distance, unit, seconds, least)


def state_of(reading: RobotReading, period_s: float) -> GateState:
    """Return the state that a gate checks, as if every existing reading had come just now."""
    stamps: Sequence[int] = reading.observation.stamp_ns
    fresh = tuple(reading.now_ns if stamp else 0 for stamp in stamps)
    observation = replace(reading.observation, t_ns=reading.now_ns, stamp_ns=fresh)
    before_ns = reading.now_ns - round(period_s * NS)
    return GateState(reading.now_ns, observation, reading.target, before_ns, True, period_s)
