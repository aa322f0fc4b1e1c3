"""The one error of every codec."""

from __future__ import annotations


class MalformedFrame(ValueError):
    """Bytes that are no frame of the protocol. The text says what is wrong with them."""
