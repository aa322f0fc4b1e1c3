"""What is refused before it reaches a wire of joints. Every gate is a pure function of the candidate and the
state; nothing is ever clipped. The tables they need are bound when the driver is built."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

from strands_actors.contract.axis import finite
from strands_actors.contract.driver import Candidate, GateCheck, GateState, Observation
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

STEP_TOLERANCE = 1.2
"""A stream's period jitters; so does the top speed of a servo with its supply."""

_ROUNDING = 1e-9

_CLEAR_IT = "clear the cause, then try again"


class Joint(Protocol):
    """What a gate needs to know of an axis."""

    @property
    def key(self) -> str: ...
    @property
    def label(self) -> str:
        """For people: the key, and the motor's id."""
        ...

    @property
    def unit(self) -> str:
        """``percent`` or what it is called."""
        ...

    @property
    def limits(self) -> tuple[float, float]: ...
    @property
    def speed(self) -> float:
        """Units per second, at most."""
        ...


Axes = Sequence[Joint]


def parse(
    action: Mapping[str, object], robot: str, axes: Axes, index: Mapping[str, int], state: GateState
) -> Candidate | Refused:
    """Names and numbers to a whole target. ``x`` and ``x.pos`` name the same joint: not both at once."""
    keys = ", ".join(axis.key for axis in axes)
    if not action:
        return Refused("empty", "move: the action names no joint", f"use {keys}", offered="{}", limit=keys)
    target = list(state.target)
    named: list[int] = []
    for key, value in action.items():
        at = index.get(key.removesuffix(".pos")) if isinstance(key, str) else None
        if at is None:
            shown = str(key)[:40] or "''"
            return Refused("unknown_joint", f"move: {shown} is not a joint of {robot}", f"use {keys}", shown, keys)
        name = axes[at].key
        if at in named:
            both = f"{name} and {name}.pos"
            return Refused("both_spellings", f"move: {both} are both given", "send one of them", both, name)
        number = finite(value)
        if number is None:
            shown = str(value)[:40]
            return Refused(
                "not_finite", f"move: {name} is {shown}", "send a finite number", shown, "a finite number"
            )
        target[at] = number
        named.append(at)
    return Candidate(tuple(target), tuple(named))


def past_travel(axes: Axes) -> GateCheck:
    limits = tuple(axis.limits for axis in axes)

    def past_travel(candidate: Candidate, state: GateState) -> Refused | None:
        for at in candidate.named:
            value = candidate.values[at]
            low, high = limits[at]
            # not (a <= b) rather than b < a: a NaN is refused too
            if not low - _ROUNDING <= value <= high + _ROUNDING:
                # rounded inwards: what the text allows is allowed
                inner_low, inner_high = _ceil(low), _floor(high)
                end = inner_low if value < low else inner_high
                return Refused(
                    "past_travel",
                    f"move: {axes[at].key} {_show(value)} {_unit(axes[at])} is past {end:.1f}",
                    f"stay within {inner_low:.1f}..{inner_high:.1f}",
                    offered=_show(value),
                    limit=f"{inner_low:.1f}..{inner_high:.1f}",
                )
        return None

    return past_travel


def stale(axes: Axes, ttl_s: float) -> GateCheck:
    ttl_ns = round(ttl_s * NS)
    remedy = "check its cable and power: it is back by itself as soon as it answers"

    def stale(candidate: Candidate, state: GateState) -> Refused | None:
        for at in candidate.named:
            stamp = state.observation.stamp_ns[at]
            age_ns = state.now_ns - stamp
            if stamp == 0 or age_ns > ttl_ns:
                age = "yet" if stamp == 0 else f"for {age_ns / 1e6:.0f} ms"
                return Refused(
                    "stale",
                    f"move: no position from {axes[at].label} {age}",
                    remedy,
                    offered=age,
                    limit=f"{ttl_s * 1e3:.0f} ms",
                )
        for at, value in enumerate(candidate.values):
            if not math.isfinite(value):  # a joint never read has no target to keep
                return Refused(
                    "stale",
                    f"move: no position from {axes[at].label} yet",
                    remedy,
                    "yet",
                    f"{ttl_s * 1e3:.0f} ms",
                )
        return None

    return stale


def voltage(axes: Axes) -> GateCheck:
    def voltage(candidate: Candidate, state: GateState) -> Refused | None:
        for at, (volt, low, high) in _readings(
            candidate, state.observation, "voltage_v", "voltage_min_v", "voltage_max_v"
        ):
            if volt < low or volt > high:
                return Refused(
                    "voltage",
                    f"move: {axes[at].label} has {volt:.1f} V",
                    f"supply {low:.1f}..{high:.1f} V",
                    offered=f"{volt:.1f}",
                    limit=f"{low:.1f}..{high:.1f}",
                )
        return None

    return voltage


def temperature(axes: Axes) -> GateCheck:
    def temperature(candidate: Candidate, state: GateState) -> Refused | None:
        for at, (celsius, high) in _readings(candidate, state.observation, "temperature_c", "temperature_max_c"):
            if celsius >= high:
                return Refused(
                    "temperature",
                    f"move: {axes[at].label} is at {celsius:.0f} deg C",
                    f"let it cool below {high:.0f} deg C",
                    offered=f"{celsius:.0f}",
                    limit=f"{high:.0f}",
                )
        return None

    return temperature


def motor_fault(axes: Axes, codes: Mapping[str, str], remedies: Mapping[str, str]) -> GateCheck:
    """What the motor itself reports, as words in ``faults``. ``codes``: word -> code of the refusal; the first
    word that has one decides. ``remedies``: by code. Silence is not judged here: ``stale`` gives it time to
    come back."""

    def motor_fault(candidate: Candidate, state: GateState) -> Refused | None:
        faults = state.observation.faults
        if not faults:
            return None
        for at in candidate.named:
            words = faults.get(axes[at].key, "").split(", ")
            words = [word for word in words if word and word != "silent"]
            if not words:
                continue
            code = next((codes[word] for word in words if word in codes), "fault")
            why = ", ".join(word for word in words if word != "limp")
            if code == "limp" or "limp" in words:
                said = f"is limp ({why})" if why else "is limp"
            else:
                said = f"reports {why}"
            remedy = remedies.get(code, _CLEAR_IT)
            return Refused(code, f"move: {axes[at].key} {said}", remedy, ", ".join(words), "no fault")
        return None

    return motor_fault


def too_fast(axes: Axes) -> GateCheck:
    """Streams only: a step the servo cannot follow means that the stream jumped. A one-shot names where to
    go, not how fast: the servo's own top speed bounds it."""

    def too_fast(candidate: Candidate, state: GateState) -> Refused | None:
        if not state.stream:
            return None
        span_s = max(state.period_s, (state.now_ns - state.target_ns) / NS)
        for at in candidate.named:
            axis = axes[at]
            step = abs(candidate.values[at] - state.target[at])
            allowed = axis.speed * span_s * STEP_TOLERANCE
            if step > allowed:
                return Refused(
                    "too_fast",
                    f"move: {axis.key} steps {_show(step)} {_unit(axis)} in {span_s * 1e3:.0f} ms",
                    f"step at most {_floor(allowed):.1f} {_unit(axis)}",
                    offered=_show(step),
                    limit=f"{_floor(allowed):.1f}",
                )
        return None

    return too_fast


def _readings(candidate: Candidate, seen: Observation, *names: str) -> Iterator[tuple[int, list[float]]]:
    rows = [seen.sensors[name] for name in names if name in seen.sensors]
    if len(rows) == len(names):
        for at in candidate.named:
            yield at, [row[at] for row in rows]


def _unit(axis: Joint) -> str:
    return "%" if axis.unit == "percent" else axis.unit


def _show(value: float) -> str:
    if abs(value) >= 1e6:
        return f"{value:.3g}"
    return f"{value:.1f}" if abs(value - round(value, 1)) < _ROUNDING else f"{value:.3f}"


def _floor(value: float) -> float:
    return math.floor(value * 10 + _ROUNDING) / 10


def _ceil(value: float) -> float:
    return math.ceil(value * 10 - _ROUNDING) / 10
