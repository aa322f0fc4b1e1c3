"""Gates of arms that go to each target within one control period. Their controller has no speed limit
that would slow the way to a far target. Pure; no value is ever clipped.

All joints are checked, named or not, because the controller receives them all. A joint that is not
named keeps its target, and may still be far from it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from strands_actors.contract.axis import Axis, AxisMode
from strands_actors.contract.driver import Candidate, GateState
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

_ROUNDING = 1e-9


def refuse_step(
    axes: Sequence[Axis], candidate: Candidate, before: Sequence[float], speeds: Sequence[float], period_s: float
) -> Refused | None:
    """Refuse a step that is longer than a joint turns in one period.

    Args:
        axes: The axes.
        candidate: The target.
        before: The last target, in axis order.
        speeds: Top speed of each joint, in rad/s.
        period_s: The period.
    """
    for at in _sent(axes, candidate, before):
        step, allowed = abs(candidate.values[at] - before[at]), speeds[at] * period_s
        if not step <= allowed + _ROUNDING:  # This refuses a NaN too.
            shown = math.floor(allowed * 1e5) / 1e5
            return Refused(
                Code.TOO_FAST,
                f"{axes[at].key} steps {step:.5g} rad, limit {shown:.5g} at {1 / period_s:.4g} Hz",
                f"step at most {shown:.5g} rad",
                f"{step:.5g}",
                f"{shown:.5g}",
            )
    return None


def refuse_lead(
    axes: Sequence[Axis], candidate: Candidate, state: GateState, speeds: Sequence[float], lead_s: float
) -> Refused | None:
    """Refuse a target too far ahead of the measured position. Either small steps come quicker than the
    joint follows, or something holds the joint back.

    Args:
        axes: The axes.
        candidate: The target.
        state: The state of the gate.
        speeds: Top speed of each joint, in rad/s.
        lead_s: The limit is the distance that a joint turns in this time.
    """
    measured = state.observation.position
    for at in _sent(axes, candidate, measured):
        lead, allowed = abs(candidate.values[at] - measured[at]), speeds[at] * lead_s
        if not lead <= allowed + _ROUNDING:
            shown = math.floor(allowed * 1e4) / 1e4
            return Refused(
                Code.RUNS_AHEAD,
                f"{axes[at].key} is to be {lead:.4g} rad from where it is, limit {shown:.4g}",
                "send targets no quicker than the robot follows them",
                f"{lead:.4g}",
                f"{shown:.4g}",
            )
    return None


def _sent(axes: Sequence[Axis], candidate: Candidate, other: Sequence[float]) -> Iterator[int]:
    """Yield the joints to check: first those that are named, then the others. Of the others, velocity axes
    are left out, because they have no distance to go, and so are joints with an unknown value."""
    yield from candidate.named
    for at, axis in enumerate(axes):
        known = math.isfinite(candidate.values[at]) and math.isfinite(other[at])
        if at not in candidate.named and axis.mode is not AxisMode.VELOCITY and known:
            yield at
