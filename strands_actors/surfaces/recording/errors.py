"""The error of recording and replaying."""

from __future__ import annotations


class RecordingError(Exception):
    """Something cannot be recorded, read or replayed. The text is one line with the reason."""
