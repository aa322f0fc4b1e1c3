"""The requests to the daemon that the simulated daemon models."""

from __future__ import annotations

from strands_actors.drivers.common.twin.modelled import Modelled

from . import protocol as p

REQUESTS: Modelled[str] = Modelled(
    "requests to the daemon",
    {
        f"GET {p.STATUS}": "returns the state of the daemon",
        f"GET {p.MOTORS}": "returns the mode of the motors",
        f"GET {p.RUNNING}": "returns the running move",
        f"GET {p.VOLUME}": "returns the volume",
        f"GET {p.TRACKED_FACE}": "returns that there is no face",
        f"GET {p.DIRECTION_OF_SOUND}": "returns a fixed direction; null without microphones",
        f"GET {p.CAMERA}": "returns the resolution",
        "GET /api/state/full": "returns head, antennas and body",
        f"GET {p.LIST_MOVES}*": "returns the names of three moves",
        f"POST {p.SET_TARGET}": "sets a target; ignored while a move runs",
        f"POST {p.GOTO}": "begins a move to a target",
        f"POST {p.WAKE_UP}": "begins the move of waking up",
        f"POST {p.GOTO_SLEEP}": "begins the move of going to sleep",
        f"POST {p.PLAY}*": "begins a recorded move, which is a nod; 404 for an unknown one",
        f"POST {p.STOP}": "ends the running move; 500 for another one",
        f"POST {p.TRACKING_ON}": "stores that the head follows a face; 'unavailable' without a camera",
        f"POST {p.TRACKING_OFF}": "ends that",
        f"POST {p.SET_VOLUME}": "stores the volume",
        f"POST {p.PLAY_SOUND}": "keeps the request, which nobody hears",
        f"POST {p.UPLOAD_SOUND}": "keeps the request",
        f"POST {p.SET_MODE}*": "sets the mode of the motors; 422 for an unknown one",
    },
    "404, not found",
)
MESSAGES: Modelled[str] = Modelled(
    f"messages on {p.SDK}",
    {
        "task": "begins a move to a target",
        "stop_move": "ends the running move",
        "set_motor_mode": "sets the mode of the motors",
        "set_torque": "switches the motors on or off",
        "set_head_tracking": "stores whether the head follows a face",
        "set_full_target": "sets a target; ignored while a move runs",
        "set_target": "sets the target of the head",
        "set_antennas": "sets the target of the antennas",
        "set_body_yaw": "sets the target of the body",
        "goto_target": "begins a move to a target",
    },
    "silence, as to every message there",
)
MODELLED = (REQUESTS, MESSAGES)
_PREFIXES = (p.LIST_MOVES, p.PLAY, p.SET_MODE)
"""Targets that end with a name."""


def request_key(method: str, target: str) -> str:
    """Return the name of a request in the table of modelled ones."""
    prefix = next((each for each in _PREFIXES if target.startswith(each) and len(target) > len(each)), "")
    moves = (p.WAKE_UP, p.GOTO_SLEEP)
    return f"{method} {target if target in moves or not prefix else f'{prefix}*'}"
