"""The services of a walking robot, such as ``stand_up()``, and its tools for an AI agent."""

from __future__ import annotations

from strands_actors.contract.driver import Service
from strands_actors.contract.tool_verbs import DURATION, SENSORS, STATE, STATUS, STOP, ToolVerb, held_move
from strands_actors.kernel.messages import sentence_case

from .dialect import MOVE_S, Dialect
from .robots import BASE

LATE_S = 1.0
"""A request of a killed process may still be carried out for this time [assumed: the vendor's client gives up after
1 s]. It may even be carried out after a later request of the root process, because that is another participant."""
SELECT_S = 15.0

_SPEEDS = {"vx": "m/s forward", "vy": "m/s to the left", "wz": "rad/s to the left"}


def services_of(dialect: Dialect) -> dict[str, Service]:
    """Return the services of a robot: its changes of posture, and ``select_sport_mode``."""
    postures = {
        name: Service(posture.about, within_s=dialect.posture_s, powers=True, late_s=LATE_S)
        for name, posture in dialect.postures.items()
    }
    select = Service(
        "give the joints back to the onboard controller after they were commanded one by one (level='low')",
        within_s=SELECT_S,
        powers=True,
        late_s=LATE_S,
    )
    return {**postures, "select_sport_mode": select}


def verbs_of(dialect: Dialect) -> tuple[ToolVerb, ...]:
    """Return the tools with which an AI agent can control the robot."""
    walks = f"Walk for {DURATION}, or for {MOVE_S:g} s, then stand. A zero stops at once."
    move = held_move(walks, _SPEEDS, dict.fromkeys(BASE, 0.0))
    postures = (
        ToolVerb(name, "service", f"{sentence_case(posture.about)}. Keep clear of the robot.")
        for name, posture in dialect.postures.items()
    )
    return SENSORS, STATE, STATUS, move, *postures, STOP
