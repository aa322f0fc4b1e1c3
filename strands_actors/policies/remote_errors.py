"""The exception for a response that does not follow a protocol of policy servers."""

from __future__ import annotations


class Misunderstood(Exception):
    """A response does not follow the protocol. The text of the exception gives the reason."""


__all__ = ["Misunderstood"]
