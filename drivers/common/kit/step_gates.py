"""Checks for arms whose controller goes to each target within one control period, however far it is.

The controller does not limit the speed, so these checks refuse a target that is too far. They are pure and never
clip a value. All joints are checked, even those that the command does not name, because the controller receives a
target for each joint. A joint that is not named keeps its target, which may still be far away.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from strands_actors.contract.axis import Axis, AxisMode
from strands_actors.contract.driver import Candidate, GateState
from strands_actors.drivers.common.kit import refusals
from strands_actors.kernel.messages import Refused

_ROUNDING = 1e-9


def refuse_step(
    axes: Sequence[Axis],
    candidate: Candidate,
    state: GateState,
    before: Sequence[float],
    speeds: Sequence[float],
    period_s: float,
) -> Refused | None:
    """Refuse a step that is longer than the joint can turn in one period.

    Args:
        axes: The axes of the arm.
        candidate: The new target.
        state: The robot's state.
        before: The last target, in axis order.
        speeds: Top speed of each joint, in rad/s.
        period_s: The time between two targets, in seconds.
    """
    for index in _sent(axes, candidate, before):
        step, allowed = abs(candidate.values[index] - before[index]), speeds[index] * period_s
        # The comparison is negated, so that it also refuses a NaN.
        if not step <= allowed + _ROUNDING:
            shown = math.floor(allowed * 1e5) / 1e5
            target = _single(candidate, state, index)
            return refusals.step_too_long(axes[index].key, step, shown, 1 / period_s, target)
    return None


def refuse_lead(
    axes: Sequence[Axis], candidate: Candidate, state: GateState, speeds: Sequence[float], lead_s: float
) -> Refused | None:
    """Refuse a target that is too far from the measured position.

    Either targets come faster than the joint can follow, or something blocks the joint.

    Args:
        axes: The axes of the arm.
        candidate: The new target.
        state: The robot's state, with the measured positions.
        speeds: Top speed of each joint, in rad/s.
        lead_s: The limit is the distance that the joint turns at top speed in this time.
    """
    measured = state.observation.position
    for index in _sent(axes, candidate, measured):
        lead, allowed = abs(candidate.values[index] - measured[index]), speeds[index] * lead_s
        if not lead <= allowed + _ROUNDING:
            shown = math.floor(allowed * 1e4) / 1e4
            return refusals.target_ahead(axes[index].key, lead, shown, _single(candidate, state, index))
    return None


def _single(candidate: Candidate, state: GateState, index: int) -> float | None:
    """Return the target that a single command names for an axis. None for a target of a stream."""
    return candidate.values[index] if index in candidate.named and not state.stream else None


def _sent(axes: Sequence[Axis], candidate: Candidate, reference: Sequence[float]) -> Iterator[int]:
    """Yield the indices of the joints to check: first those that the command names, then the others.

    Of the others, velocity axes are left out, because they have no distance to go. Joints with an unknown value are
    also left out.
    """
    yield from candidate.named
    for index, axis in enumerate(axes):
        comparable = math.isfinite(candidate.values[index]) and math.isfinite(reference[index])
        if index not in candidate.named and axis.mode is not AxisMode.VELOCITY and comparable:
            yield index
