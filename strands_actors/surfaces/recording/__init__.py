"""Recordings of a robot: every command, refusal, observation, safe frame and change of state, and
their replay.

with record(robot, "run.mcap"):
    robot.send_action({"shoulder_pan": 10.0})

outcome = replay(read(Path("run.mcap")))
"""

from .errors import RecordingError
from .file import Recording, read
from .player import Difference, Outcome, replay
from .script import record

__all__ = ["Difference", "Outcome", "Recording", "RecordingError", "read", "record", "replay"]
