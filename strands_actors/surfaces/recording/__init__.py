"""Recordings of a robot: every command, refusal, observation, safe frame and change of state, and
their replay.

with record(robot, "run.mcap"):
    robot.send_action({"shoulder_pan": 10.0})

outcome = replay(read(Path("run.mcap")))
"""

from strands_actors.contract.extras import require

require("record", "a recording")  # before the import below says only which module is not there

from .errors import RecordingError  # noqa: E402
from .file import Recording, read  # noqa: E402
from .player import Difference, Outcome, replay  # noqa: E402
from .script import record  # noqa: E402

__all__ = ["Difference", "Outcome", "Recording", "RecordingError", "read", "record", "replay"]
