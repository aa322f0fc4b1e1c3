"""The error of recording and replaying."""

from __future__ import annotations


class RecordingError(Exception):
    """Something cannot be recorded, read or replayed. The message is one line that explains why."""
