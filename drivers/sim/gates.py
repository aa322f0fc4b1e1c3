"""The gates of a simulation. They refuse a command that would have no effect, a target past the range of
its joint (unless that is lifted), and a number that the physics cannot compute with."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import show, unit_of
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.drivers.sim.refusals import SimCode
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

HELD_BY_WIRE = "held by the robot on its wire"
LET_GO = "limp"
"""Why a joint does not follow the simulation, as written in ``Observation.faults``."""


FARTHEST = 1e4
"""Radians, metres, or the like per second, of the model. MuJoCo drops all controls of a step when one
of them is 1e10 or more, and the other joints would run to zero."""


def computable(axes: Sequence[Axis], units: Sequence[tuple[float, float]]) -> GateCheck:
    """Refuse a target farther than ``FARTHEST`` from the joint's zero, even if its range has no limit."""

    def computable(candidate: Candidate, state: GateState) -> Refused | None:
        for at in candidate.named:
            axis, (zero, scale) = axes[at], units[at]
            value = candidate.values[at]
            if not abs(value - zero) <= FARTHEST * abs(scale):
                most = show(FARTHEST * abs(scale), axis.unit)
                offered = show(value, axis.unit)
                why = f"{axis.key} {offered}{unit_of(axis)} is farther than physics can be computed"
                return Refused(Code.PAST_TRAVEL, why, f"stay within {most} of its zero", offered, most)
        return None

    return computable


def held(axes: Sequence[str]) -> GateCheck:
    def held(candidate: Candidate, state: GateState) -> Refused | None:
        for at in candidate.named:
            axis = axes[at]
            why = state.observation.faults.get(axis)
            if why is not None:
                there = "stop it there, then " if why == HELD_BY_WIRE else ""
                remedy = f"{there}stop() and resume() here take it"
                return Refused(SimCode.NOT_HELD, f"{axis} is {why}", remedy, why, "held by the simulation")
        return None

    return held
