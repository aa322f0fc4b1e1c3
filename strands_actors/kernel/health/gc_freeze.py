"""What is there before a robot moves at a policy's word is not searched for garbage while it moves.

A full collection walks every container of the process, with the interpreter's lock held: 77 ms were
measured in a test run of 90 000 of them, and a deep-learning framework has many times that. A
setpoint of legs lives for 100 ms. What is made meanwhile is collected as ever.
"""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Iterator

FROZEN_AT_START = 1000
"""Python 3.12 begins with some 400 objects frozen; a program that freezes its heap has thousands."""

_lock = threading.Lock()
_movers = 0
_was_frozen = False


@contextlib.contextmanager
def left_alone() -> Iterator[None]:
    """For a block; the blocks of several robots may overlap. Whoever had frozen a part of the heap
    (``gc.freeze``) before the first of them keeps it frozen."""
    global _movers, _was_frozen
    with _lock:
        if not _movers:
            _was_frozen = gc.get_freeze_count() > FROZEN_AT_START
        _movers += 1
        gc.freeze()
    try:
        yield
    finally:
        with _lock:
            _movers -= 1
            if not _movers and not _was_frozen:
                gc.unfreeze()
