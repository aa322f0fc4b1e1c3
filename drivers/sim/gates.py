"""The one thing that is refused in simulation beyond what an action says: a command that would have
no effect."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.kernel.messages import Refused

HELD_BY_WIRE = "held by the robot on its wire"
LET_GO = "limp"
"""Why a joint does not follow the simulation, as ``Observation.faults`` says it."""


def held(axes: Sequence[str]) -> GateCheck:
    def held(candidate: Candidate, state: GateState) -> Refused | None:
        for at in candidate.named:
            axis = axes[at]
            why = state.observation.faults.get(axis)
            if why is not None:
                there = "stop it there, then " if why == HELD_BY_WIRE else ""
                remedy = f"{there}stop() and resume() here take it"
                return Refused("not_held", f"move: {axis} is {why}", remedy, why, "held by the simulation")
        return None

    return held
