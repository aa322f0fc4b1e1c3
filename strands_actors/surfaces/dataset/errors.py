"""What a dataset refuses."""

from __future__ import annotations

from strands_actors.surfaces.recording.errors import RecordingError


class DatasetError(RecordingError):
    """One line: what cannot be recorded, repaired, merged or read, and why."""


class DamagedError(DatasetError):
    """Files are damaged or contradict each other. Nothing was written."""
