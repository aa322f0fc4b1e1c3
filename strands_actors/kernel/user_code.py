"""Call a user's code in a thread, so that the caller gets every failure as an ``Exception``.

Otherwise ``sys.exit()``, a cancelled asyncio client or Ctrl-C in that code would go through every task of this
process, and end all robots of its script.
"""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable
from typing import TypeVar, TypeVarTuple

from .actor import describe

Args = TypeVarTuple("Args")
Result = TypeVar("Result")


_OURS = os.path.join(os.path.dirname(os.path.dirname(os.path.abspath(__file__))), "")


class UserCodeEnded(Exception):
    """The code raised something that is no ``Exception``. The text describes it."""


def contained(call: Callable[[*Args], Result], *args: *Args) -> Result:
    """Return ``call(*args)``. Raise ``UserCodeEnded`` if it raises something that is no ``Exception``."""
    try:
        return call(*args)
    except Exception:
        raise
    except BaseException as error:
        raise UserCodeEnded(describe(error)) from error


def describe_failure(error: BaseException) -> str:
    """Return one line: the exception, and the last line outside of this package that led to it.

    Lines before the call (of threads and this package) do not count.
    """
    raised = error.__cause__ if isinstance(error, UserCodeEnded) and error.__cause__ else error
    frames = list(traceback.extract_tb(raised.__traceback__))
    calls = [
        index
        for index, frame in enumerate(frames)
        if (frame.filename, frame.name) == (__file__, contained.__name__)
    ]
    called = frames[calls[-1] + 1 :] if calls else frames
    theirs = [frame for frame in called if not frame.filename.startswith(_OURS)]
    if not theirs:
        return describe(error)
    last = theirs[-1]
    return f"{describe(error)} ({os.path.basename(last.filename)}:{last.lineno} in {last.name})"
