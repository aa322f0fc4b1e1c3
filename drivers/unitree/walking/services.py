"""The services and tool verbs of a walking robot beyond the common ones."""

from __future__ import annotations

from strands_actors.contract.driver import Service
from strands_actors.contract.tool_verbs import DURATION, SENSORS, STATE, STATUS, STOP, ToolVerb, held_move

from .dialect import MOVE_S, Dialect
from .robots import BASE

LATE_S = 1.0
"""Latest time at which a request of a killed participant may be carried out [assumed: the vendor's client
gives up after 1 s]. The root is another participant, so its requests may overtake that one."""
SELECT_S = 15.0

_SPEEDS = {"vx": "m/s forward", "vy": "m/s to the left", "wz": "rad/s to the left"}


def services_of(dialect: Dialect) -> dict[str, Service]:
    """Return the services of a robot with this dialect."""
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
    """Return the tool verbs for an agent."""
    walks = f"Walk for {DURATION}, or for {MOVE_S:g} s, then stand. A zero stops at once."
    move = held_move(walks, _SPEEDS, dict.fromkeys(BASE, 0.0))
    postures = (
        ToolVerb(name, "service", f"{posture.about[0].upper()}{posture.about[1:]}. Keep clear of the robot.")
        for name, posture in dialect.postures.items()
    )
    return SENSORS, STATE, STATUS, move, *postures, STOP
