"""Datasets of demonstrations in LeRobot's format, recorded beside a robot by a process of its
own."""

from strands_actors.contract.extras import require

require("dataset", "a dataset")  # before an import below says only which module is not there

from .errors import DatasetError  # noqa: E402
from .played import replay_episode  # noqa: E402
from .script import DatasetRecording, record_dataset  # noqa: E402

__all__ = ["DatasetError", "DatasetRecording", "record_dataset", "replay_episode"]
