"""Calling what a user wrote, in a thread: whatever it raises is an ``Exception`` for who asked.

``sys.exit()``, a cancelled asyncio client or Ctrl-C raised in there would else go through every task
of this process, and end all robots of its script.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, TypeVarTuple

from .actor import describe

Args = TypeVarTuple("Args")
Result = TypeVar("Result")


class UserCodeEnded(Exception):
    """What it raised was no ``Exception``; the text says what."""


def contained(call: Callable[[*Args], Result], *args: *Args) -> Result:
    """Call it. Raise ``UserCodeEnded`` in place of what is no ``Exception``."""
    try:
        return call(*args)
    except Exception:
        raise
    except BaseException as error:
        raise UserCodeEnded(describe(error)) from error
