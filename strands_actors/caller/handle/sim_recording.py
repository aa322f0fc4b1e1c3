"""Record a simulation with ``start_recording`` and ``stop_recording``, which are verbs of strands-robots.

They record one episode of a dataset, with ``record_dataset``.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from strands_actors.contract.extras import MissingExtra
from strands_actors.contract.shown import shown

from . import envelopes as answers
from .envelopes import Answer

if TYPE_CHECKING:
    from strands_actors.surfaces.dataset import DatasetRecording

CODECS: Mapping[str, str] = {"h264": "mpeg4", "libsvtav1": "av1"}
"""Names of codecs in strands-robots, and the codec that is used here. All encoders for H.264 are under the
GPL."""
UNTITLED = "untitled"
"""Default task of an episode."""
INFO = Path("meta/info.json")


class HasName(Protocol):
    """The part of a robot's handle that a recording needs."""

    @property
    def name(self) -> str:
        """The robot's name among the robots that run."""
        ...


class SimRecording:
    """The recording of one simulation. It records one episode at a time."""

    def __init__(self) -> None:
        self._recording: DatasetRecording | None = None
        self._about: dict[str, Any] = {}

    def start(
        self,
        robot: HasName,
        repo_id: str,
        task: str,
        fps: int,
        root: str | os.PathLike[str] | None,
        codec: str | None,
        overwrite: bool,
        cameras: Sequence[str],
    ) -> Answer:
        """Begin an episode of a running robot. The arguments are those of ``SimRobot.start_recording``."""
        if self._recording is not None:
            return answers.error(f"start_recording: {self._about['root']} is being recorded. Call stop_recording()")
        try:
            from strands_actors.surfaces.dataset import DatasetError, record_dataset
            from strands_actors.surfaces.recording import RecordingError
        except MissingExtra as missing:
            return answers.error(f"start_recording: {missing}")
        try:
            folder = folder_of(repo_id) if root is None else Path(os.fspath(root)).expanduser()
            if overwrite:
                remove_dataset(folder)
            recording = record_dataset(
                robot, folder, task=task or UNTITLED, fps=fps, cameras=cameras, codec=CODECS.get(codec or "", codec)
            ).__enter__()
        except (DatasetError, RecordingError, TypeError, ValueError, OSError) as failure:
            return answers.error(f"start_recording: {failure}")
        try:
            recording.start()
        except (DatasetError, RecordingError) as failure:
            recording.__exit__(type(failure), failure, None)
            return answers.error(f"start_recording: {failure}")
        self._recording = recording
        self._about = {"repo_id": repo_id, "root": str(folder), "task": task or UNTITLED, "fps": fps}
        return answers.success({"recording": True, **self._about})

    def stop(self) -> Answer:
        """End the episode, and save it. Without an episode it is a success with ``recording`` false."""
        recording, self._recording = self._recording, None
        if recording is None:
            return answers.success({"recording": False, "reason": "nothing was recorded"})
        from strands_actors.surfaces.recording import RecordingError

        try:
            try:
                recording.finish()
            finally:
                recording.__exit__(None, None, None)
        except RecordingError as failure:
            return answers.error(f"stop_recording: {failure}")
        return answers.success({"recording": False, **self._about, **recording.saved[-1]})

    def status(self) -> Answer:
        """Return whether an episode is being recorded, with the keys of the last ``start``."""
        return answers.success({"recording": self._recording is not None, **self._about})


def folder_of(repo_id: object) -> Path:
    """Return the folder of a dataset.

    Args:
        repo_id: A path, or ``owner/name`` for a folder in LeRobot's folder.

    Raises:
        ValueError: ``repo_id`` is not text, or leads out of LeRobot's folder.
    """
    if not isinstance(repo_id, str) or not repo_id.strip() or "\0" in repo_id:
        raise ValueError(f"repo_id is {shown(repo_id)}. Give owner/name, or a path")
    if repo_id.startswith(("/", ".", "~")):
        return Path(repo_id).expanduser()
    if ".." in Path(repo_id).parts:
        raise ValueError(f"repo_id is {shown(repo_id)}. Give owner/name, or a path")
    cache = os.environ.get("HF_HOME") or Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "huggingface"
    home = os.environ.get("HF_LEROBOT_HOME") or Path(cache) / "lerobot"
    return Path(home).expanduser() / repo_id


def remove_dataset(folder: Path) -> None:
    """Remove the folder of a dataset, if it exists. Raise ``ValueError`` for any other folder with files."""
    if not folder.exists():
        return
    if not (folder / INFO).is_file() and any(folder.iterdir()):
        raise ValueError(f"{folder} has files but is no dataset, so it is not removed. Give another root")
    shutil.rmtree(folder)
