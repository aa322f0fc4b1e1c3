"""What recording and replaying refuse."""

from __future__ import annotations


class RecordingError(Exception):
    """One line: what cannot be recorded, read or replayed, and why."""
