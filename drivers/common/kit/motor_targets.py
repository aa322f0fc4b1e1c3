"""Targets of motors that take position, speed, torque and gains at once, as in legged robots.

This module parses an action into a target and refuses a target out of limits. It is pure and never
clips a value. A target is five rows, each in the order of the joints: q (rad), dq (rad/s), tau (Nm),
kp (Nm/rad), kd (Nm s/rad).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol

import msgspec
from msgspec.structs import replace

from strands_actors.contract.axis import Axis, finite
from strands_actors.contract.axis_gates import STEP_TOLERANCE, past_range, too_fast
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.drivers.common.kit.refusals import MotorCode
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

ROWS = ("q", "dq", "tau", "kp", "kd")
Q, DQ, TAU, KP, KD = range(len(ROWS))
_ROW = {name: row for row, name in enumerate(ROWS)}

LONGEST_STEP_S = 0.1
"""Longest period that the step gate counts. A slower stream may step no further than a joint turns in
this time."""

FLOAT32_ROUNDING = 1e-6
"""Numbers are float32 on the wire, and in the robot's reports."""


class Joint(msgspec.Struct, frozen=True):
    """One motor, in radians, newton metres and seconds."""

    key: str
    slot: int
    mode: int  # value of its slot's mode field that makes it obey
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
    """The table of a robot's motors that can be commanded."""

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
    """Parse the joints of a table: one line each, in the columns of ``Joint``.

    Raises:
        ValueError: A line has another number of columns, or a column is no number.
    """
    return tuple(_parse_joint(line) for line in text.splitlines() if line.strip())


def _parse_joint(line: str) -> Joint:
    words = line.split()
    if len(words) != len(Joint.__struct_fields__):
        raise ValueError(f"a joint has {len(Joint.__struct_fields__)} columns, this has {len(words)}: {line}")
    columns = zip(Joint.__struct_fields__, words, strict=True)
    return msgspec.convert({name: _COLUMNS.get(name, float)(word) for name, word in columns}, Joint)


# -- names and numbers


class Parser:
    """Turn an action, which has joints by name, into a whole target."""

    def __init__(self, model: Motors) -> None:
        self._model = model
        self._keys = ", ".join(joint.key for joint in model.joints)
        self._count = len(model.joints)
        self._index = {spelling: at for at, joint in enumerate(model.joints) for spelling in _spellings(joint.key)}
        zero = (0.0,) * self._count
        self._rest = (*zero, *zero, *(joint.kp for joint in model.joints), *(joint.kd for joint in model.joints))

    def parse(self, action: Mapping[str, object], state: GateState) -> Candidate | Refused:
        """Return the whole target of an action, or a refusal.

        A number is q in radians, sent with the joint's own gains. A dict has q, and any other row that
        differs from the joint's default. A joint that is not named keeps its target; before the first
        target it is held at its measured position.
        """
        count = self._count
        if not action:
            return Refused(Code.EMPTY, "the action names no joint", f"use {self._keys}", "{}", self._keys)
        fresh = len(state.target) == count  # The robot was armed, and no target was accepted since.
        before = state.observation.position if fresh else state.target
        whole = len(action) == count
        target = [*before[:count], *self._rest] if fresh or whole else list(before)
        index = self._index
        named: list[int] = []
        for key, value in action.items():
            at = index.get(key)
            if at is None:
                return self._unknown(key)
            if not whole:
                target[at + count :: count] = self._rest[at::count]
            if type(value) is float and math.isfinite(value):
                target[at] = value
            else:
                refusal = self._take(target, at, value)
                if refusal is not None:
                    return refusal
            named.append(at)
        if len(set(named)) < len(named):
            return self._twice(next(at for at in named if named.count(at) > 1))
        return Candidate(tuple(target), tuple(named))

    def named(self, action: Mapping[str, object]) -> list[int]:
        """Return the joints of an accepted action, by index, in the order of the motors."""
        return sorted(self._index[key] for key in action)

    def _take(self, target: list[float], at: int, value: object) -> Refused | None:
        """Set the rows of a joint whose value is no plain float. This runs 500 times a second for every
        joint, so the checks of known names and floats come first."""
        if type(value) is not dict:
            value = dict(value) if isinstance(value, Mapping) else {"q": value}
        if "q" not in value:
            return self._without_q(at, value)
        count = self._count
        for name, part in value.items():
            row = _ROW.get(name)
            if row is None:
                return self._unknown_row(at, name)
            if type(part) is not float or not math.isfinite(part):
                number = finite(part)
                if number is None:
                    return self._no_number(at, name, part)
                part = number
            target[at + count * row] = part
        return None

    def _without_q(self, at: int, value: Mapping[Any, object]) -> Refused:
        return Refused(
            MotorCode.NO_Q,
            f"{self._model.joints[at].key} has no q",
            "give q in radians, and of dq, tau, kp, kd what is wanted",
            ", ".join(str(name)[:40] for name in value) or "{}",
            ", ".join(ROWS),
        )

    def _unknown_row(self, at: int, name: object) -> Refused:
        shown, known = str(name)[:40] or "''", ", ".join(ROWS)
        why = f"{self._model.joints[at].key}.{shown} is not known"
        return Refused(Code.UNKNOWN_KEY, why, f"use {known}", shown, known)

    def _no_number(self, at: int, name: object, part: object) -> Refused:
        shown = str(part)[:40]
        why = f"{self._model.joints[at].key}.{name} is {shown}"
        return Refused(Code.NOT_FINITE, why, "send a finite number", shown, "a finite number")

    def _unknown(self, key: object) -> Refused:
        shown = str(key)[:40] or "''"
        why = f"{shown} is not a joint of {self._model.name}"
        return Refused(Code.UNKNOWN_JOINT, why, f"use {self._keys}", shown, self._keys)

    def _twice(self, at: int) -> Refused:
        both = " and ".join(_spellings(self._model.joints[at].key)[:2])
        return Refused(Code.BOTH_SPELLINGS, f"{both} are both given", "send one of them", both)


def _spellings(key: str) -> tuple[str, ...]:
    """Return the accepted spellings of a joint. Names in the models end with ``_joint``; those on the wire
    do not always."""
    bare = key.removesuffix("_joint")
    return bare, f"{bare}_joint", f"{bare}.pos", f"{bare}_joint.pos"


# -- gates


def target_gates(model: Motors, control_s: float) -> tuple[GateCheck, ...]:
    """Return the gates in the order of the checks. The first that refuses gives the answer."""
    in_range = past_range(_table(model), rounding=FLOAT32_ROUNDING)
    return (
        finite_rows(model),
        in_range,
        within(model, DQ),
        within(model, TAU),
        gains(model),
        steps(model, control_s),
    )


def _table(model: Motors) -> tuple[Axis, ...]:
    return tuple(joint.axis for joint in model.joints)


def finite_rows(model: Motors) -> GateCheck:
    """Refuse a target with a number that is not finite, even for a joint that is not named. Such a joint
    holds its measured position, and its values are sent with its gains all the same."""
    count = len(model.joints)

    def finite_rows(candidate: Candidate, state: GateState) -> Refused | None:
        values = candidate.values
        if all(map(math.isfinite, values)):
            return None
        place, value = next((place, value) for place, value in enumerate(values) if not math.isfinite(value))
        row, at = divmod(place, count)
        key, remedy = model.joints[at].key, "send a finite number"
        if at not in candidate.named:
            remedy = "wait until the robot tells where it is, or name it with a finite q"
        why = f"{key}.{ROWS[row]} is {value}"
        return Refused(Code.NOT_FINITE, why, remedy, str(value), "a finite number")

    return finite_rows


_WORDS = {DQ: (Code.TOO_FAST, "dq", "rad/s"), TAU: (MotorCode.TOO_STRONG, "tau", "Nm")}


def within(model: Motors, row: int) -> GateCheck:
    """Refuse a speed or a torque (by ``row``) beyond the joint's limit."""
    count = len(model.joints)
    most = tuple(joint.speed if row == DQ else joint.torque for joint in model.joints)
    code, name, unit = _WORDS[row]
    first = count * row
    nothing = (0.0,) * count

    def within(candidate: Candidate, state: GateState) -> Refused | None:
        values = candidate.values
        if values[first : first + count] == nothing:  # the usual case, 500 times a second
            return None
        for at in candidate.named:
            value = values[first + at]
            if not -most[at] <= value <= most[at]:
                limit = f"-{most[at]:g}..{most[at]:g} {unit}"
                why = f"{model.joints[at].key}.{name}={value:.4g} is outside {limit}"
                return Refused(code, why, "stay within it", f"{value:.4g}", limit)
        return None

    return within


def gains(model: Motors) -> GateCheck:
    count = len(model.joints)
    rows = ((KP, "kp", model.max_kp), (KD, "kd", model.max_kd))

    def gains(candidate: Candidate, state: GateState) -> Refused | None:
        values = candidate.values
        if values[KP * count :] == state.target[KP * count :]:  # the usual case: accepted before
            return None
        for row, name, most in rows:
            first = count * row
            for at in candidate.named:
                if not 0.0 <= values[first + at] <= most:
                    value, limit = f"{values[first + at]:.4g}", f"0..{most:g}"
                    why = f"{model.joints[at].key}.{name}={value} is outside {limit}"
                    return Refused(MotorCode.GAIN, why, "stay within it", value, limit)
        return None

    return gains


def steps(model: Motors, control_s: float) -> GateCheck:
    """Refuse a step from the last target that is longer than the joint turns in one period of the stream.

    A single command counts as one period of the control loop, because a far target is a blow. The first
    command steps from the measured position.
    """
    count = len(model.joints)
    from_target = too_fast(
        _table(model),
        oneshot_s=control_s * STEP_TOLERANCE,
        longest_s=LONGEST_STEP_S,
        pause_counts=False,
    )

    def steps(candidate: Candidate, state: GateState) -> Refused | None:
        if len(state.target) == count:  # Nothing was accepted since it was armed.
            state = replace(state, target=state.observation.position)
        return from_target(candidate, state)

    return steps
