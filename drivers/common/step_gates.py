"""Gates of arms whose controller goes to each target within one control period, at once: it has no
speed of its own that a far target could not exceed. Pure; nothing is ever clipped.

All joints are looked at, named or not: the controller is sent them all. One that is not named keeps
its target, and may still be far from it.
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
    """Refuse a step from ``before`` that is more than a joint turns in ``period_s`` at its speed,
    radians a second."""
    for at in _sent(axes, candidate, before):
        step, allowed = abs(candidate.values[at] - before[at]), speeds[at] * period_s
        if not step <= allowed + _ROUNDING:  # a NaN is refused too
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
    """Refuse a target further ahead of the measured position than a joint turns in ``lead_s``:
    small steps come quicker than it follows, or something holds it back."""
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
    """Return the joints to look at: those that are named, then the others. Of these a velocity has
    no way to go, and of one that is not known on either side nothing can be said."""
    yield from candidate.named
    for at, axis in enumerate(axes):
        known = math.isfinite(candidate.values[at]) and math.isfinite(other[at])
        if at not in candidate.named and axis.mode is not AxisMode.VELOCITY and known:
            yield at
