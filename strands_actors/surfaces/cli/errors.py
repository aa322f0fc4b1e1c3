"""The error of a command that cannot run."""

from __future__ import annotations


class Problem(Exception):
    """A command cannot run. The message is one line on stderr, and the exit code is 2."""
