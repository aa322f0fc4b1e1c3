"""Apply the checks of each part's driver to the commands of the whole robot. Pure."""

from __future__ import annotations

from typing import Any

import msgspec

from strands_actors.contract.driver import Candidate, Condition, Driver, GateCheck, GateState, OnResume, Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused

from . import refusals
from .config import HELD, PART_STATE, STOPPED, PartConfig


def part_of(observation: Observation, part: PartConfig) -> Observation:
    """Return the reading of one part, by its own names, from a reading of the robot."""
    cut = len(part.prefix)

    def own(rows: dict[str, Any]) -> dict[str, Any]:
        return {name[cut:]: row for name, row in rows.items() if name.startswith(part.prefix)}

    return Observation(
        observation.t_ns,
        observation.position[part.span],
        observation.stamp_ns[part.span],
        observation.velocity[part.span],
        own(observation.sensors),
        own(observation.faults),
    )


def state_of(state: GateState, part: PartConfig) -> GateState:
    return msgspec.structs.replace(
        state, observation=part_of(state.observation, part), target=state.target[part.span]
    )


def gate_of(part: PartConfig, driver: Driver) -> GateCheck:
    """Return all gates of a part's driver as one gate of the robot."""

    def check(candidate: Candidate, state: GateState) -> Refused | None:
        own_state = state_of(state, part)
        named = tuple(index - part.first for index in candidate.named if part.has(index))
        own = Candidate(candidate.values[part.span], named, candidate.until_ns)
        refused = (gate(own, own_state) for gate in driver.gates)
        refusal = next((refusal for refusal in refused if refusal is not None), None)
        return None if refusal is None else refusals.of_part(part.name, refusal)

    return check


def conditions_of(part: PartConfig, driver: Driver) -> tuple[Condition, ...]:
    """Return the conditions of a part's driver as conditions of the robot."""

    def moved(condition: Condition) -> Condition:
        def check(observation: Observation, now_ns: int) -> Refused | None:
            refusal = condition.check(part_of(observation, part), now_ns)
            return None if refusal is None else refusals.of_part(part.name, refusal)

        return msgspec.structs.replace(condition, check=check)

    return tuple(moved(condition) for condition in driver.conditions)


def together(part: PartConfig) -> tuple[Condition, ...]:
    """Return the conditions that stop the robot, or make it hold, when one part has done so by itself."""

    def stopped(observation: Observation, now_ns: int) -> Refused | None:
        if observation.sensors.get(part.prefix + PART_STATE, (0.0,))[0] != STOPPED:
            return None
        return refusals.part_stopped(part.name, observation.faults.get(part.name, ""))

    def held(observation: Observation, now_ns: int) -> Refused | None:
        if observation.sensors.get(part.prefix + PART_STATE, (0.0,))[0] != HELD:
            return None
        return refusals.part_held(part.name, observation.faults.get(part.name, ""))

    return (
        Condition(stopped, Reason.FAULT, always=True, on_resume=OnResume.ARM_ANEW),
        Condition(held, Reason.EXPIRED, on_resume=OnResume.STAY_ARMED),
    )
