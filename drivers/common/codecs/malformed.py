"""The error that every codec raises."""

from __future__ import annotations


class MalformedFrame(ValueError):
    """The received bytes are not a valid frame of the protocol. The exception's text describes the error."""
