"""Gates of a simulated robot. They refuse a command that would have no effect, a target outside the joint's range,
and a number that is too large for the physics."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import show, unit_of
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.kernel.messages import Refused

from . import refusals

HELD_BY_WIRE = "held by the robot on its wire"
NOT_ENERGISED = "limp"
"""Why a joint does not follow the simulation, as written in ``Observation.faults``."""


FARTHEST = 1e4
"""Largest target in the model's units: radians, metres, or these per second. MuJoCo drops all targets of a step
when one of them is 1e10 or more, and the other joints would move to zero."""


def computable(axes: Sequence[Axis], units: Sequence[tuple[float, float]]) -> GateCheck:
    """Refuse a target that is farther than ``FARTHEST`` from the joint's zero. This holds for joints without a
    range, too."""

    def computable(candidate: Candidate, state: GateState) -> Refused | None:
        for index in candidate.named:
            axis, (zero, scale) = axes[index], units[index]
            value = candidate.values[index]
            if not abs(value - zero) <= FARTHEST * abs(scale):
                most = show(FARTHEST * abs(scale), axis.unit)
                return refusals.too_large(axis.key, show(value, axis.unit), unit_of(axis), most)
        return None

    return computable


def refuse_not_held(axes: Sequence[str]) -> GateCheck:
    def refuse_not_held(candidate: Candidate, state: GateState) -> Refused | None:
        for index in candidate.named:
            axis = axes[index]
            reason = state.observation.faults.get(axis)
            if reason is not None:
                return refusals.not_held(axis, reason, reason == HELD_BY_WIRE)
        return None

    return refuse_not_held
