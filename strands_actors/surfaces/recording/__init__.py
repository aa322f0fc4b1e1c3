"""Record a robot, and replay the recording to check each decision again.

A recording has every command, refusal, observation, stop and change of state.

with record(robot, "run.mcap"):
    robot.send_action({"shoulder_pan": 10.0})

outcome = replay("run.mcap")
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .errors import RecordingError

if TYPE_CHECKING:
    from .file import Recording, read
    from .player import Difference, Outcome, replay
    from .script import record

_WHERE = {
    "Difference": "player",
    "Outcome": "player",
    "Recording": "file",
    "read": "file",
    "record": "script",
    "replay": "player",
}

__all__ = ["Difference", "Outcome", "Recording", "RecordingError", "read", "record", "replay"]


def __getattr__(name: str) -> Any:
    # Import each module on first use, because a recorder of datasets does not need the packages for MCAP files.
    if name in _WHERE:
        return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
