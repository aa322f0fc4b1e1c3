"""Gates that follow from the table of axes: freshness, range and speed. Pure.

A gate refuses a value and never clips it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol

from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .axis import AxisMode
from .driver import Candidate, GateCheck, GateState

STEP_TOLERANCE = 1.2
"""Factor on the allowed step. The period of a stream jitters, and so does the top speed of a servo with its
supply voltage."""

READING_NOISE = 5e-4
"""Part of the travel of an axis by which two readings may differ while it stands still [assumed]."""

_ROUNDING = 1e-9
_DECIMALS = {"deg": 1, "percent": 1, "%": 1, "mm": 1}
_OTHER_DECIMALS = 4
"""For radians, metres and fractions. The digits suffice for a limit to be accepted as a refusal shows it."""
_MOST_DECIMALS = 12


class Limited(Protocol):
    """The part of an axis that a gate needs. ``contract.axis.Axis`` has it."""

    @property
    def key(self) -> str:
        """The name of the axis in an action."""
        ...

    @property
    def label(self) -> str:
        """The axis and its motor, for the text of a refusal."""
        ...

    @property
    def unit(self) -> str:
        """The unit of the value, also of ``limits`` and ``speed``."""
        ...

    @property
    def limits(self) -> tuple[float, float]:
        """The range of the value, lowest and highest."""
        ...

    @property
    def speed(self) -> float:
        """The largest change of the value in a second; infinite for no limit."""
        ...

    @property
    def mode(self) -> AxisMode:
        """Whether the value is a position or a speed."""
        ...


Axes = Sequence[Limited]


def axis_gates(
    axes: Axes, state_ttl_s: float, *, oneshot_s: float | None = None, longest_s: float = 0.1
) -> tuple[GateCheck, ...]:
    """Return the gates of a robot, in the order in which they are checked. The first refusal counts.

    Args:
        axes: The axes.
        state_ttl_s: The oldest reading that counts, in seconds (``stale``).
        oneshot_s: The time of a single command (``too_fast``).
        longest_s: The longest pause of a stream that counts, in seconds (``too_fast``).
    """
    return (
        stale(axes, state_ttl_s),
        past_range(axes),
        too_fast(axes, oneshot_s=oneshot_s, longest_s=longest_s),
    )


def stale(axes: Axes, ttl_s: float) -> GateCheck:
    """Return a gate that refuses to move an axis if its position was not read within ``ttl_s``."""
    ttl_ns = round(ttl_s * NS)
    limit = f"{ttl_s * 1e3:.0f} ms"
    remedy = "check its cable and power: it is back by itself as soon as it answers"

    def stale(candidate: Candidate, state: GateState) -> Refused | None:
        for at in candidate.named:
            stamp = state.observation.stamp_ns[at]
            age_ns = state.now_ns - stamp
            if stamp == 0 or age_ns > ttl_ns:
                age = "yet" if stamp == 0 else f"for {age_ns / 1e6:.0f} ms"
                return Refused(Code.STALE, f"no position from {axes[at].label} {age}", remedy, age, limit)
        for at, value in enumerate(candidate.values[: len(axes)]):
            # An axis that was never read has no target to keep.
            if not math.isfinite(value):
                return Refused(Code.STALE, f"no position from {axes[at].label} yet", remedy, "yet", limit)
        return None

    return stale


def past_range(axes: Axes, *, rounding: float = _ROUNDING, measured: bool = True) -> GateCheck:
    """Return a gate that refuses a target outside the range of its axis.

    An axis that is past its end may be kept at its position, or be brought back.

    Args:
        axes: The axes.
        rounding: The error of a number on the way to the robot and back. An axis at its end is within its
            range.
        measured: False if the axes are not those of the observation. A target outside is then refused wherever
            the robot is.
    """
    ends = tuple((low - rounding, high + rounding) for low, high in (axis.limits for axis in axes))

    def past_range(candidate: Candidate, state: GateState) -> Refused | None:
        values = candidate.values
        for at in candidate.named:
            value, (least, most) = values[at], ends[at]
            # ``not (a <= b)`` and not ``b < a``, so that a NaN is refused too.
            if not least <= value <= most and not (measured and _no_further(axes[at], at, value, state)):
                return _past_range(axes[at], value)
        return None

    return past_range


class _Narrower(NamedTuple):
    """An axis with another range."""

    key: str
    label: str
    unit: str
    limits: tuple[float, float]
    speed: float
    mode: AxisMode


def past_ranges(axes: Axes, ranges: Iterable[tuple[float, float]]) -> GateCheck:
    """Return ``past_range`` for axes with these ends: lowest and highest value, in the unit of the axis."""
    return past_range(
        [
            _Narrower(axis.key, axis.label, axis.unit, ends, axis.speed, axis.mode)
            for axis, ends in zip(axes, ranges, strict=True)
        ]
    )


def outside_reported_range(axes: Axes, lows: str, highs: str, untold: GateCheck) -> GateCheck:
    """Return a gate that refuses a target outside the range that the robot itself reports.

    Args:
        axes: The axes.
        lows: The sensor with the lowest values.
        highs: The sensor with the highest values.
        untold: The gate for an observation without these sensors.
    """
    within = functools.lru_cache(maxsize=4)(functools.partial(past_ranges, axes))

    def outside_reported_range(candidate: Candidate, state: GateState) -> Refused | None:
        sensors = state.observation.sensors
        ranges = tuple(zip(sensors.get(lows, ()), sensors.get(highs, ()), strict=True))
        return (within(ranges) if ranges else untold)(candidate, state)

    return outside_reported_range


def _no_further(axis: Limited, at: int, value: float, state: GateState) -> bool:
    """Return True if a position outside the range does not lead further out.

    It is then no further out than the measured position or the last target. A policy that returns the observed
    positions holds a joint that rests on its end stop.
    """
    if axis.mode is not AxisMode.POSITION:
        return False
    low, high = axis.limits
    measured, target = state.observation.position[at], state.target[at]
    noise = READING_NOISE * (high - low)
    if value > high:
        return value <= measured + noise or value <= target
    return value >= measured - noise or value >= target


def _past_range(axis: Limited, value: float) -> Refused:
    low, high = axis.limits
    # Rounded inwards, so that the gate accepts the limits in the text.
    bottom, top = show(low, axis.unit, inwards=math.ceil), show(high, axis.unit, inwards=math.floor)
    end = bottom if value < low else top
    offered = _show_past(value, low if value < low else high, axis.unit)
    return Refused(
        Code.PAST_TRAVEL,
        f"{axis.key} {offered}{unit_of(axis)} is past {end}",
        f"stay within {bottom}..{top}",
        offered=offered,
        limit=f"{bottom}..{top}",
    )


def _show_past(value: float, end: float, unit: str) -> str:
    """Return ``value`` with enough digits to show that it is past ``end``."""
    shown = show(value, unit)
    digits = _DECIMALS.get(unit, _OTHER_DECIMALS)
    while math.isfinite(value) and digits < _MOST_DECIMALS and not _is_past(float(shown), value, end):
        digits += 1
        shown = f"{value:.{digits}f}"
    return shown


def _is_past(shown: float, value: float, end: float) -> bool:
    return shown > end if value > end else shown < end


def too_fast(
    axes: Axes,
    *,
    tolerance: float = STEP_TOLERANCE,
    oneshot_s: float | None = None,
    longest_s: float = math.inf,
    pause_counts: bool = True,
) -> GateCheck:
    """Return a gate that refuses a step that the axis cannot follow.

    In a stream, the step may be as far as the axis moves in the period, or since the last accepted target if
    that is longer. A single command may step as far as the axis moves in ``oneshot_s``.

    Args:
        axes: The axes.
        tolerance: Factor on the step in a stream, since a period jitters.
        oneshot_s: None allows any distance, for a servo that limits its own speed.
        longest_s: The longest pause of a stream that counts.
        pause_counts: False if only the period counts, for a controller that goes to each target in one period.
    """
    speeds = tuple(axis.speed for axis in axes)

    def too_fast(candidate: Candidate, state: GateState) -> Refused | None:
        if state.stream:
            pause_s = (state.now_ns - state.target_ns) / NS if pause_counts else 0.0
            period_s = min(max(state.period_s, pause_s), longest_s)
            reach_s = period_s * tolerance
        elif oneshot_s is not None:
            reach_s = period_s = oneshot_s
        else:
            return None
        values, target = candidate.values, state.target
        for at in candidate.named:
            step = abs(values[at] - target[at])
            allowed = speeds[at] * reach_s
            if not step <= allowed + _ROUNDING:
                axis = axes[at]
                most = show(allowed, axis.unit, inwards=math.floor)
                unit = unit_of(axis)
                return Refused(
                    Code.TOO_FAST,
                    f"{axis.key} steps {show(step, axis.unit)}{unit} in {period_s * 1e3:.3g} ms",
                    f"step at most {most}{unit}",
                    offered=show(step, axis.unit),
                    limit=most,
                )
        return None

    return too_fast


def show(value: float, unit: str, inwards: object = None) -> str:
    """Return ``value`` with the digits of its unit.

    Args:
        value: A number in ``unit``.
        unit: Degrees, percent and millimetres have one decimal, other units four.
        inwards: ``math.floor`` or ``math.ceil``, so that a limit is rounded into its range. None shows two more
            digits if the value needs them.
    """
    digits = _DECIMALS.get(unit, _OTHER_DECIMALS)
    if not math.isfinite(value):
        return str(value)
    if abs(value) >= 1e6:
        return f"{value:.3g}"
    if inwards is math.floor:
        value = math.floor(value * 10**digits + _ROUNDING) / 10**digits
    elif inwards is math.ceil:
        value = math.ceil(value * 10**digits - _ROUNDING) / 10**digits
    elif abs(value - round(value, digits)) >= _ROUNDING:
        return f"{value:.{digits + 2}f}"
    return f"{value:.{digits}f}"


def unit_of(axis: Limited) -> str:
    """Return the unit to put after a number, with a space. It is empty for a plain fraction."""
    unit = "%" if axis.unit == "percent" else axis.unit
    return f" {unit}" if unit else ""


__all__ = [
    "READING_NOISE",
    "STEP_TOLERANCE",
    "Axes",
    "AxisMode",
    "Limited",
    "axis_gates",
    "past_range",
    "show",
    "stale",
    "too_fast",
    "unit_of",
]
