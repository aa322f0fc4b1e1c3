"""What a command says when it cannot do what it was asked."""

from __future__ import annotations


class Problem(Exception):
    """One line for the user, on stderr; the command ends with exit code 2."""
