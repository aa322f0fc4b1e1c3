"""What is refused before it reaches a leg. Every gate and condition is pure; nothing is ever
clipped.

A target is five rows, each in the order of the joints: q (rad), dq (rad/s), tau (Nm), kp (Nm/rad),
kd (Nm s/rad).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from msgspec.structs import replace

from strands_actors.contract.axis import finite
from strands_actors.contract.axis_gates import STEP_TOLERANCE, past_range, too_fast
from strands_actors.contract.driver import Candidate, Condition, ConditionCheck, GateCheck, GateState, Observation
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from .robots import Model
from .rpc import FSM_WORDS

CONTROL_HZ = 500.0
CONTROL_S = 1 / CONTROL_HZ

ROWS = ("q", "dq", "tau", "kp", "kd")
Q, DQ, TAU, KP, KD = range(len(ROWS))
_ROW = {name: row for row, name in enumerate(ROWS)}

HANDSHAKE_FSM = (500, 501, 801)
FSM_TTL_S = 1.0
MODE_TTL_S = 1.0
BATTERY_TTL_S = 10.0
"""Of a battery that has a topic of its own [assumed]: it is published slowly."""
BATTERY_FLOOR_PCT = 15.0

LONGEST_STEP_S = 0.1
"""A slower stream may not step further than a joint turns meanwhile."""

FLOAT32_ROUNDING = 1e-6
"""Numbers are float32 on the wire, and as the robot reports them."""


# -- names and numbers


class Parser:
    """An action, joints by name, to a whole target."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._keys = ", ".join(model.axes)
        self._count = len(model.joints)
        self._index = {spelling: at for at, joint in enumerate(model.joints) for spelling in _spellings(joint.key)}
        zero = (0.0,) * self._count
        self._rest = (*zero, *zero, *(joint.kp for joint in model.joints), *(joint.kd for joint in model.joints))

    def parse(self, action: Mapping[str, object], state: GateState) -> Candidate | Refused:
        """A number is q in radians, sent with the joint's own gains; a dict has q and what differs
        from that. A joint that is not named keeps its target; as long as there is none, it is held
        where it is."""
        count = self._count
        if not action:
            return Refused("empty", "move: the action names no joint", f"use {self._keys}", "{}", self._keys)
        fresh = len(state.target) == count  # armed, and nothing accepted since
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
        """Of an accepted action, in the order of the motors."""
        return sorted(self._index[key] for key in action)

    def _take(self, target: list[float], at: int, value: object) -> Refused | None:
        """What is no plain float. 500 times a second and for every joint: known names and floats
        come first."""
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
            "no_q",
            f"move: {self._model.joints[at].key} has no q",
            "give q in radians, and of dq, tau, kp, kd what is wanted",
            ", ".join(str(name)[:40] for name in value) or "{}",
            ", ".join(ROWS),
        )

    def _unknown_row(self, at: int, name: object) -> Refused:
        shown, known = str(name)[:40] or "''", ", ".join(ROWS)
        why = f"move: {self._model.joints[at].key}.{shown} is not known"
        return Refused("unknown_key", why, f"use {known}", shown, known)

    def _no_number(self, at: int, name: object, part: object) -> Refused:
        shown = str(part)[:40]
        why = f"move: {self._model.joints[at].key}.{name} is {shown}"
        return Refused("not_finite", why, "send a finite number", shown, "a finite number")

    def _unknown(self, key: object) -> Refused:
        shown = str(key)[:40] or "''"
        why = f"move: {shown} is not a joint of {self._model.name}"
        return Refused("unknown_joint", why, f"use {self._keys}", shown, self._keys)

    def _twice(self, at: int) -> Refused:
        both = " and ".join(_spellings(self._model.joints[at].key)[:2])
        return Refused("both_spellings", f"move: {both} are both given", "send one of them", both)


def _spellings(key: str) -> tuple[str, ...]:
    """The models' names carry ``_joint``, the wire's do not always."""
    bare = key.removesuffix("_joint")
    return bare, f"{bare}_joint", f"{bare}.pos", f"{bare}_joint.pos"


# -- of the robot: asked before every setpoint, and all the time while one is live


def conditions(model: Model, floor_pct: float, state_ttl_s: float) -> tuple[Condition, ...]:
    """In the order in which they are asked: the first that refuses answers."""
    handshake = fsm if model.handshake == "fsm" else sport_mode
    checks = (stale(state_ttl_s), handshake, battery_known, battery_above(floor_pct))
    return tuple(Condition(check) for check in checks)


def stale(ttl_s: float) -> ConditionCheck:
    ttl_ns = round(ttl_s * NS)

    def stale(observation: Observation, now_ns: int) -> Refused | None:
        stamp_ns = observation.stamp_ns[0]
        if stamp_ns == 0:
            why = "move: no LowState yet, mode_machine unknown"
            return Refused("no_state", why, "wait for the first, or check the network")
        age_ns = now_ns - stamp_ns
        if age_ns <= ttl_ns:
            return None
        age, limit = f"{age_ns / 1e6:.0f} ms", f"{ttl_s * 1e3:.0f} ms"
        why = f"move: last LowState is {age} old (limit {limit})"
        return Refused("stale", why, "check the robot and the network", age, limit)

    return stale


_HANDSHAKE = ", ".join(map(str, HANDSHAKE_FSM))


def fsm(observation: Observation, now_ns: int) -> Refused | None:
    """G1: low-level commands are for the states that balance."""
    known = observation.sensors.get("fsm")
    if known is None:
        why = "move: the FSM id is not known"
        return Refused("fsm_unknown", why, "check that the robot has booted", "", _HANDSHAKE)
    number, read_s = known
    age_s = now_ns / NS - read_s
    if age_s > FSM_TTL_S:
        why = f"move: FSM id is {age_s:.1f} s old (limit {FSM_TTL_S:.1f} s)"
        age, limit = f"{age_s:.1f} s", f"{FSM_TTL_S:.1f} s"
        return Refused("fsm_stale", why, "check the robot's sport service", age, limit)
    if number in HANDSHAKE_FSM:
        return None
    word = FSM_WORDS.get(round(number))
    shown = f"{number:g} ({word})" if word else f"{number:g}"
    why = f"move: FSM {shown} does not accept low-level commands; needs 500, 501 or 801"
    return Refused("fsm", why, "bring the robot there by its remote", f"{number:g}", _HANDSHAKE)


def sport_mode(observation: Observation, now_ns: int) -> Refused | None:
    """The others: their own controller must have let go, and have said so of late."""
    known = observation.sensors.get("sport_mode_released")
    remedy = "call release_sport_mode() first: the robot no longer balances by itself then"
    if known is None:
        return Refused("sport_mode_unknown", "move: the onboard mode is not known", remedy, "", "released")
    released, read_s = known
    age_s = now_ns / NS - read_s
    if age_s > MODE_TTL_S:
        why = f"move: the onboard mode is {age_s:.1f} s old (limit {MODE_TTL_S:.1f} s)"
        age = f"{age_s:.1f} s"
        return Refused("sport_mode_stale", why, "check the robot's network", age, f"{MODE_TTL_S:.1f} s")
    if released:
        return None
    name = observation.faults.get("sport_mode", "")
    return Refused("sport_mode", f"move: sport mode {name} still active", remedy, name, "released")


def battery_known(observation: Observation, now_ns: int) -> Refused | None:
    stamp_s = observation.sensors.get("battery_stamp_s")
    if stamp_s is None:
        why = "move: the battery's charge is not known"
        return Refused("battery_unknown", why, "check the robot's battery topic", "unknown", "a state of charge")
    age_s = now_ns / NS - stamp_s[0]
    if age_s > BATTERY_TTL_S:
        why = f"move: the battery's charge is {age_s:.0f} s old (limit {BATTERY_TTL_S:.0f} s)"
        return Refused("battery_unknown", why, "check the robot's battery topic", f"{age_s:.0f} s")
    return None


def battery_above(floor_pct: float) -> ConditionCheck:
    def battery_above(observation: Observation, now_ns: int) -> Refused | None:
        known = observation.sensors.get("battery_pct")
        if known is None or known[0] >= floor_pct:
            return None
        charge = f"{known[0]:.1f} %"
        why = f"move: battery {charge} is under the floor of {floor_pct:.1f} %"
        return Refused("battery_low", why, "charge it", charge, f"{floor_pct:.1f} %")

    return battery_above


# -- of the command


def gates(model: Model) -> tuple[GateCheck, ...]:
    """Return the gates in the order in which they are asked: the first that refuses answers."""
    in_range = past_range(model.table, rounding=FLOAT32_ROUNDING)
    return in_range, within(model, DQ), within(model, TAU), gains(model), steps(model)


_WORDS = {DQ: ("too_fast", "dq", "rad/s"), TAU: ("too_strong", "tau", "Nm")}


def within(model: Model, row: int) -> GateCheck:
    """The speed or the torque that is asked for, against what the joint has."""
    count = len(model.joints)
    most = tuple(joint.speed if row == DQ else joint.torque for joint in model.joints)
    code, name, unit = _WORDS[row]
    first = count * row
    nothing = (0.0,) * count

    def within(candidate: Candidate, state: GateState) -> Refused | None:
        values = candidate.values
        if values[first : first + count] == nothing:  # most often, and 500 times a second
            return None
        for at in candidate.named:
            value = values[first + at]
            if not -most[at] <= value <= most[at]:
                limit = f"-{most[at]:g}..{most[at]:g} {unit}"
                why = f"move: {model.joints[at].key}.{name}={value:.4g} is outside {limit}"
                return Refused(code, why, "stay within it", f"{value:.4g}", limit)
        return None

    return within


def gains(model: Model) -> GateCheck:
    count = len(model.joints)
    rows = ((KP, "kp", model.max_kp), (KD, "kd", model.max_kd))

    def gains(candidate: Candidate, state: GateState) -> Refused | None:
        values = candidate.values
        if values[KP * count :] == state.target[KP * count :]:  # most often: it was let pass before
            return None
        for row, name, most in rows:
            first = count * row
            for at in candidate.named:
                if not 0.0 <= values[first + at] <= most:
                    value, limit = f"{values[first + at]:.4g}", f"0..{most:g}"
                    why = f"move: {model.joints[at].key}.{name}={value} is outside {limit}"
                    return Refused("gain", why, "stay within it", value, limit)
        return None

    return gains


def steps(model: Model) -> GateCheck:
    """Refuse a step from the last target that is more than the joint turns in one period of the
    stream; a command on its own is one period of the control loop: a far target is a blow. The
    first one starts from where the joint is."""
    count = len(model.joints)
    from_target = too_fast(
        model.table,
        oneshot_s=CONTROL_S * STEP_TOLERANCE,
        longest_s=LONGEST_STEP_S,
        pause_counts=False,
    )

    def steps(candidate: Candidate, state: GateState) -> Refused | None:
        if len(state.target) == count:  # nothing was accepted since it was armed
            state = replace(state, target=state.observation.position)
        return from_target(candidate, state)

    return steps
