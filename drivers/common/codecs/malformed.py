"""The error that every codec raises."""

from __future__ import annotations


class MalformedFrame(ValueError):
    """Bytes that are no frame of the protocol. The text names the error."""
