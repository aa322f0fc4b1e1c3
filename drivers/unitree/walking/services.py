"""What a robot that walks can be asked beyond the common verbs: by its program, and by an agent."""

from __future__ import annotations

from strands_actors.contract.driver import Service
from strands_actors.contract.tool_verbs import DURATION, SENSORS, STATE, STATUS, STOP, ToolVerb, held_move

from .dialect import MOVE_S, Dialect
from .robots import BASE

LATE_S = 1.0
"""A request of a participant that was killed may be carried out so late [assumed: the vendor's client
gives up after 1 s]. The root is another participant, and its requests may overtake it."""
SELECT_S = 15.0

_SPEEDS = {"vx": "m/s forward", "vy": "m/s to the left", "wz": "rad/s to the left"}


def services_of(dialect: Dialect) -> dict[str, Service]:
    """Return what such a robot does beyond the common verbs."""
    postures = {
        name: Service(posture.about, within_s=dialect.posture_s, powers=True, needs_armed=True, late_s=LATE_S)
        for name, posture in dialect.postures.items()
    }
    select = Service(
        "give the joints back to the onboard controller after they were commanded one by one (level='low')",
        within_s=SELECT_S,
        powers=True,
        needs_armed=True,
        late_s=LATE_S,
    )
    return {**postures, "select_sport_mode": select}


def verbs_of(dialect: Dialect) -> tuple[ToolVerb, ...]:
    """Return what an agent may ask."""
    walks = f"Walk for {DURATION}, or for {MOVE_S:g} s, then stand. A zero stops at once."
    move = held_move(walks, _SPEEDS, dict.fromkeys(BASE, 0.0))
    postures = (
        ToolVerb(name, "service", f"{posture.about[0].upper()}{posture.about[1:]}. Keep clear of the robot.")
        for name, posture in dialect.postures.items()
    )
    return SENSORS, STATE, STATUS, move, *postures, STOP
