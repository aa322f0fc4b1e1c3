"""Datasets of demonstrations in LeRobot's format. A separate process records them from a running robot."""

from strands_actors.contract.extras import require

require("dataset", "a dataset")  # The imports below would raise an error without the name of the extra.

from .errors import DatasetError  # noqa: E402
from .played import replay_episode  # noqa: E402
from .script import DatasetRecording, record_dataset  # noqa: E402

__all__ = ["DatasetError", "DatasetRecording", "record_dataset", "replay_episode"]
