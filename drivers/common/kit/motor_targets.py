"""Check targets of motors that take position, speed, torque and gains at once, as in legged robots.

This module converts an action into a target, and refuses a target that exceeds the limits. It is pure and never
clips a value. A target has five rows of values, each in the order of the joints: q (rad), dq (rad/s), tau (Nm), kp
(Nm/rad), kd (Nm s/rad).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Protocol

import msgspec
from msgspec.structs import replace

from strands_actors.contract.axis import Axis, finite
from strands_actors.contract.axis_gates import STEP_TOLERANCE, past_range, too_fast
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.contract.refusals import empty_action, not_finite, unknown_joint
from strands_actors.contract.shown import SHOWN
from strands_actors.drivers.common.kit import refusals
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

ROWS = ("q", "dq", "tau", "kp", "kd")
Q, DQ, TAU, KP, KD = range(len(ROWS))
_ROW = {name: row for row, name in enumerate(ROWS)}
_ROW_NAMES = ", ".join(ROWS)

LONGEST_STEP_S = 0.1
"""Longest period that the step gate counts. A slower stream may step no further than a joint turns in
this time."""

FLOAT32_ROUNDING = 1e-6
"""Numbers are float32 on the wire, and in the robot's reports."""


class Joint(msgspec.Struct, frozen=True):
    """One joint with its motor: its limits and default gains, in radians, newton metres and seconds."""

    key: str
    slot: int
    mode: int  # value of the ``mode`` field in the motor's command, with which the motor obeys
    low: float
    high: float
    torque: float
    speed: float
    kp: float
    kd: float

    @property
    def axis(self) -> Axis:
        return Axis(key=self.key, unit="rad", low=self.low, high=self.high, speed=self.speed, id=self.slot)


class Motors(Protocol):
    """The joints of one robot model that can be commanded."""

    @property
    def name(self) -> str: ...
    @property
    def joints(self) -> tuple[Joint, ...]: ...
    @property
    def max_kp(self) -> float: ...
    @property
    def max_kd(self) -> float: ...


_COLUMNS = {"key": str, "slot": int, "mode": int}


def parse_joints(text: str) -> tuple[Joint, ...]:
    """Parse a table of joints. Each line is one joint; its columns are the fields of ``Joint``.

    Raises:
        ValueError: A line has another number of columns, or a column is not a number.
    """
    return tuple(_parse_joint(line) for line in text.splitlines() if line.strip())


def _parse_joint(line: str) -> Joint:
    words = line.split()
    if len(words) != len(Joint.__struct_fields__):
        raise ValueError(f"a joint has {len(Joint.__struct_fields__)} columns, not {len(words)}: {line}")
    columns = zip(Joint.__struct_fields__, words, strict=True)
    return msgspec.convert({name: _COLUMNS.get(name, float)(word) for name, word in columns}, Joint)


# -- converting an action into a target


class Parser:
    """Convert an action, a dict by joint name, into a target for all joints."""

    def __init__(self, model: Motors) -> None:
        self._model = model
        self._keys = ", ".join(joint.key for joint in model.joints)
        self._count = len(model.joints)
        self._index = {
            spelling: index for index, joint in enumerate(model.joints) for spelling in _spellings(joint.key)
        }
        zero = (0.0,) * self._count
        self._rest = (*zero, *zero, *(joint.kp for joint in model.joints), *(joint.kd for joint in model.joints))

    def parse(self, action: Mapping[str, object], state: GateState) -> Candidate | Refused:
        """Convert an action into a target for all joints, or return a refusal.

        The value of a joint is a number or a dict. A number is q in radians, and the joint's default gains apply. A
        dict has q, and may replace dq, tau, kp and kd. A joint that the action does not name keeps its target. If
        there is no target yet, it holds its measured position.
        """
        count = self._count
        if not action:
            return empty_action(self._keys)
        # ``state.target`` has only positions until the first target after arming is accepted.
        fresh = len(state.target) == count
        before = state.observation.position if fresh else state.target
        whole = len(action) == count
        target = [*before[:count], *self._rest] if fresh or whole else list(before)
        index_of = self._index
        named: list[int] = []
        for key, value in action.items():
            index = index_of.get(key)
            if index is None:
                return unknown_joint(str(key)[:SHOWN] or "''", self._model.name, self._keys)
            if not whole:
                target[index + count :: count] = self._rest[index::count]
            if type(value) is float and math.isfinite(value):
                target[index] = value
            else:
                refusal = self._take(target, index, value)
                if refusal is not None:
                    return refusal
            named.append(index)
        if len(set(named)) < len(named):
            twice = next(index for index in named if named.count(index) > 1)
            bare, full, *_ = _spellings(self._model.joints[twice].key)
            return refusals.named_twice(bare, full)
        return Candidate(tuple(target), tuple(named))

    def named(self, action: Mapping[str, object]) -> list[int]:
        """Return the indices of the joints that an accepted action names, in ascending order."""
        return sorted(self._index[key] for key in action)

    def _take(self, target: list[float], index: int, value: object) -> Refused | None:
        """Set the target of a joint whose value is a dict, or a number that is not a finite float.

        Actions arrive up to 500 times a second, so the common cases are checked first.
        """
        if type(value) is not dict:
            value = dict(value) if isinstance(value, Mapping) else {"q": value}
        key = self._model.joints[index].key
        if "q" not in value:
            return refusals.no_q(key, ", ".join(str(name)[:SHOWN] for name in value) or "{}", _ROW_NAMES)
        count = self._count
        for name, part in value.items():
            row = _ROW.get(name)
            if row is None:
                return refusals.unknown_row(key, str(name)[:SHOWN] or "''", _ROW_NAMES)
            if type(part) is not float or not math.isfinite(part):
                number = finite(part)
                if number is None:
                    text = str(part)[:SHOWN]
                    return not_finite(f"{key}.{name}", text, text)
                part = number
            target[index + count * row] = part
        return None


def _spellings(key: str) -> tuple[str, ...]:
    """Return the accepted names of a joint. In robot models a joint's name ends with ``_joint``; in the robot's
    messages it may not."""
    bare = key.removesuffix("_joint")
    return bare, f"{bare}_joint", f"{bare}.pos", f"{bare}_joint.pos"


# -- gates


def target_gates(model: Motors, control_s: float, plans_motion: bool, late_s: float = 0.0) -> tuple[GateCheck, ...]:
    """Return the checks of a target, in their order. If several checks refuse, the first refusal is reported.

    Args:
        model: The motors.
        control_s: The period of the control loop.
        plans_motion: As for ``too_fast``.
        late_s: As for ``steps``.
    """
    in_range = past_range(_table(model), rounding=FLOAT32_ROUNDING)
    return (
        finite_rows(model),
        in_range,
        within(model, DQ),
        within(model, TAU),
        gains(model),
        steps(model, control_s, plans_motion, late_s),
    )


def _table(model: Motors) -> tuple[Axis, ...]:
    return tuple(joint.axis for joint in model.joints)


def finite_rows(model: Motors) -> GateCheck:
    """Refuse a target with a number that is not finite, even for a joint that the action does not name.

    The motor of such a joint also receives a target: its measured position, which may not be finite.
    """
    count = len(model.joints)

    def finite_rows(candidate: Candidate, state: GateState) -> Refused | None:
        values = candidate.values
        if all(map(math.isfinite, values)):
            return None
        place, value = next((place, value) for place, value in enumerate(values) if not math.isfinite(value))
        row, index = divmod(place, count)
        key, text = f"{model.joints[index].key}.{ROWS[row]}", str(value)
        if index not in candidate.named:
            return refusals.unnamed_not_finite(key, text)
        return not_finite(key, text, text)

    return finite_rows


_PAST_LIMIT: Mapping[int, Callable[[str, float, float], Refused]] = {
    DQ: refusals.speed_past_limit,
    TAU: refusals.torque_past_limit,
}


def within(model: Motors, row: int) -> GateCheck:
    """Refuse a speed (row ``DQ``) or a torque (row ``TAU``) that exceeds the joint's limit."""
    count = len(model.joints)
    most = tuple(joint.speed if row == DQ else joint.torque for joint in model.joints)
    past_limit = _PAST_LIMIT[row]
    first = count * row
    nothing = (0.0,) * count

    def within(candidate: Candidate, state: GateState) -> Refused | None:
        values = candidate.values
        # Usually all values are 0. This early return saves time, because the check runs 500 times a second.
        if values[first : first + count] == nothing:
            return None
        for index in candidate.named:
            value = values[first + index]
            if not -most[index] <= value <= most[index]:
                return past_limit(model.joints[index].key, value, most[index])
        return None

    return within


def gains(model: Motors) -> GateCheck:
    count = len(model.joints)
    rows = ((KP, "kp", model.max_kp), (KD, "kd", model.max_kd))

    def gains(candidate: Candidate, state: GateState) -> Refused | None:
        values = candidate.values
        # Usually the gains are those of the last target, which were accepted before.
        if values[KP * count :] == state.target[KP * count :]:
            return None
        for row, name, most in rows:
            first = count * row
            for index in candidate.named:
                if not 0.0 <= values[first + index] <= most:
                    return refusals.gain_past_limit(model.joints[index].key, name, values[first + index], most)
        return None

    return gains


def steps(model: Motors, control_s: float, plans_motion: bool, late_s: float = 0.0) -> GateCheck:
    """Refuse a step from the last target that is longer than the joint turns in one period of the stream.

    A single command may step as far as the joint turns in one period of the control loop, because a motor would
    drive to a far target at full force. The first step counts from the measured position.

    Args:
        model: The motors.
        control_s: The period of the control loop.
        plans_motion: As for ``too_fast``.
        late_s: A setpoint of a stream that comes late may step as far as the joint turns since the last one, but
            at most as far as in this time.
    """
    count = len(model.joints)
    from_target = too_fast(
        _table(model),
        oneshot_s=control_s * STEP_TOLERANCE,
        longest_s=LONGEST_STEP_S,
        pause_counts=False,
        plans_motion=plans_motion,
    )

    def steps(candidate: Candidate, state: GateState) -> Refused | None:
        # No target was accepted since the robot was armed, so the step starts at the measured position.
        if len(state.target) == count:
            state = replace(state, target=state.observation.position)
        if late_s and state.stream:
            pause_s = min(late_s, (state.now_ns - state.target_ns) / NS)
            state = replace(state, period_s=max(state.period_s, pause_s))
        return from_target(candidate, state)

    return steps
