"""Errors of datasets."""

from __future__ import annotations

from strands_actors.surfaces.recording.errors import RecordingError


class DatasetError(RecordingError):
    """A dataset cannot be recorded, repaired, merged or read. The message is one line that explains why."""


class DamagedError(DatasetError):
    """Files are damaged or contradict each other. Nothing was written."""
