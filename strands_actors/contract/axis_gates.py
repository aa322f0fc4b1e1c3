"""Gates: functions that refuse a command to an axis. Pure.

The reason is a position that was not read lately, or a target that is out of range or too far away. A gate refuses
a value and never clips it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol

from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals
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
    """The properties of an axis that a gate needs. ``contract.axis.Axis`` has them all."""

    @property
    def key(self) -> str:
        """The name of the axis in an action."""
        ...

    @property
    def label(self) -> str:
        """The name of the axis and the number of its motor, for the text of a refusal."""
        ...

    @property
    def unit(self) -> str:
        """The unit of the value, of ``limits``, and of ``speed`` (per second)."""
        ...

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and the highest value."""
        ...

    @property
    def speed(self) -> float:
        """The largest change of the value in a second; infinite if there is no limit."""
        ...

    @property
    def mode(self) -> AxisMode:
        """Whether the value is a position or a speed."""
        ...


Axes = Sequence[Limited]


def axis_gates(
    axes: Axes, state_ttl_s: float, *, oneshot_s: float | None = None, longest_s: float = 0.1
) -> tuple[GateCheck, ...]:
    """Return the gates of a robot, in the order in which they are called.

    The first refusal is returned to the user.

    Args:
        axes: The axes.
        state_ttl_s: The largest age of a reading, in seconds. An older one makes ``stale`` refuse.
        oneshot_s: The time that ``too_fast`` allows for a single command, in seconds; None for any distance.
        longest_s: The longest pause between two setpoints of a stream for which ``too_fast`` allows a longer
            step, in seconds.
    """
    return (
        stale(axes, state_ttl_s),
        past_range(axes),
        too_fast(axes, oneshot_s=oneshot_s, longest_s=longest_s),
    )


def stale(axes: Axes, ttl_s: float) -> GateCheck:
    """Return a gate that refuses to move an axis if its last measured position is older than ``ttl_s``."""
    ttl_ns = round(ttl_s * NS)
    limit = f"{ttl_s * 1e3:.0f} ms"

    def stale(candidate: Candidate, state: GateState) -> Refused | None:
        for index in candidate.named:
            stamp = state.observation.stamp_ns[index]
            age_ns = state.now_ns - stamp
            if stamp == 0:
                return refusals.no_position(axes[index].label, limit)
            if age_ns > ttl_ns:
                return refusals.stale_position(axes[index].label, age_ns / 1e6, limit)
        for index, value in enumerate(candidate.values[: len(axes)]):
            # The axis was never read, so it has no target that it could keep.
            if not math.isfinite(value):
                return refusals.no_position(axes[index].label, limit)
        return None

    return stale


def past_range(axes: Axes, *, rounding: float = _ROUNDING, measured: bool = True) -> GateCheck:
    """Return a gate that refuses a target outside the range of its axis.

    If an axis is already out of range, a target that keeps it there or moves it back is allowed.

    Args:
        axes: The axes.
        rounding: The error of a number on the way to the robot and back. The range is wider by this.
        measured: False if ``axes`` are not the axes of the observation. Then every target out of range is refused.
    """
    ends = tuple((low - rounding, high + rounding) for low, high in (axis.limits for axis in axes))

    def past_range(candidate: Candidate, state: GateState) -> Refused | None:
        values = candidate.values
        for index in candidate.named:
            value, (least, most) = values[index], ends[index]
            # This condition is also false for a NaN, which must be refused, too.
            if not least <= value <= most and not (measured and _no_further(axes[index], index, value, state)):
                return _past_range(axes[index], value)
        return None

    return past_range


class _Narrower(NamedTuple):
    """An axis with another range than the driver declares."""

    key: str
    label: str
    unit: str
    limits: tuple[float, float]
    speed: float
    mode: AxisMode


def past_ranges(axes: Axes, ranges: Iterable[tuple[float, float]]) -> GateCheck:
    """Return the gate ``past_range`` for axes with other ranges: (lowest, highest), in the axis' unit."""
    return past_range(
        [
            _Narrower(axis.key, axis.label, axis.unit, ends, axis.speed, axis.mode)
            for axis, ends in zip(axes, ranges, strict=True)
        ]
    )


def outside_reported_range(axes: Axes, lows: str, highs: str, fallback: GateCheck) -> GateCheck:
    """Return a gate that refuses a target outside the range that the robot itself reports.

    Args:
        axes: The axes.
        lows: The name of the sensor that reports the lowest value of each axis.
        highs: The name of the sensor that reports the highest value of each axis.
        fallback: The gate to use while the robot has not reported these sensors.
    """
    within = functools.lru_cache(maxsize=4)(functools.partial(past_ranges, axes))

    def outside_reported_range(candidate: Candidate, state: GateState) -> Refused | None:
        sensors = state.observation.sensors
        ranges = tuple(zip(sensors.get(lows, ()), sensors.get(highs, ()), strict=True))
        return (within(ranges) if ranges else fallback)(candidate, state)

    return outside_reported_range


def _no_further(axis: Limited, index: int, value: float, state: GateState) -> bool:
    """Return True if a target outside the range does not lead further out than the axis is.

    The target is compared with the measured position and with the last target. So a policy that returns the
    observed positions can hold a joint that rests on its end stop.
    """
    if axis.mode is not AxisMode.POSITION:
        return False
    low, high = axis.limits
    measured, target = state.observation.position[index], state.target[index]
    noise = READING_NOISE * (high - low)
    if value > high:
        return value <= measured + noise or value <= target
    return value >= measured - noise or value >= target


def _past_range(axis: Limited, value: float) -> Refused:
    low, high = axis.limits
    # The limits are rounded inwards, so that the gate accepts the limits that the text shows.
    bottom, top = show(low, axis.unit, inwards=math.ceil), show(high, axis.unit, inwards=math.floor)
    end = bottom if value < low else top
    offered = _show_past(value, low if value < low else high, axis.unit)
    return refusals.past_travel(axis.key, offered, unit_of(axis), end, f"{bottom}..{top}")


def _show_past(value: float, end: float, unit: str) -> str:
    """Return ``value`` as text with enough digits to show that it is past ``end``."""
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
    plans_motion: bool = True,
) -> GateCheck:
    """Return a gate that refuses a step that the axis cannot follow.

    In a stream, an axis may step as far as it moves in one period. After a longer pause it may step as far as it
    moves since the last accepted target. A single command may step as far as the axis moves in ``oneshot_s``.

    Args:
        axes: The axes.
        tolerance: Factor on the allowed step in a stream, since the period varies.
        oneshot_s: Time for a single command, in seconds. None allows any distance, for a servo that limits its
            speed.
        longest_s: The longest pause of a stream for which a longer step is allowed, in seconds.
        pause_counts: False if a pause never allows a longer step, for a controller that goes to each target in one
            period.
        plans_motion: False for a robot without ``move_to``, which is otherwise a remedy for a single command.
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
        for index in candidate.named:
            step = abs(values[index] - target[index])
            allowed = speeds[index] * reach_s
            if not step <= allowed + _ROUNDING:
                axis = axes[index]
                most = show(allowed, axis.unit, inwards=math.floor)
                is_planned = plans_motion and not state.stream and axis.mode is AxisMode.POSITION
                target_or_none = values[index] if is_planned else None
                shown, unit = show(step, axis.unit), unit_of(axis)
                return refusals.too_fast(axis.key, shown, unit, period_s * 1e3, most, target_or_none)
        return None

    return too_fast


def show(value: float, unit: str, inwards: object = None) -> str:
    """Return ``value`` as text, with as many decimals as its unit needs.

    Args:
        value: A number in ``unit``.
        unit: Degrees, percent and millimetres have one decimal, other units four.
        inwards: ``math.floor`` for an upper limit, ``math.ceil`` for a lower one. So the shown limit is within the
            range. None: show two more digits if the value needs them.
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
    """Return the unit with a space before it, to append to a number. It is empty for a value without a unit."""
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
