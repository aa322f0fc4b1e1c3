"""Keep the garbage collector from walking old objects while a robot moves.

A full collection walks every container of the process with the interpreter's lock held. It took 77 ms in a test
run with 90 000 containers, and a deep-learning framework has many times that. A setpoint for legs is valid for
100 ms. Objects that are made during the block are collected as usual.
"""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Iterator

FROZEN_AT_START = 1000
"""More frozen objects than this mean that the program has frozen its heap itself. Python 3.12 begins with some
400; such a program has thousands."""

_lock = threading.Lock()
_movers = 0
_was_frozen = False


@contextlib.contextmanager
def frozen_objects() -> Iterator[None]:
    """Freeze the present objects within the block. The blocks of several robots may overlap.

    Objects that the program froze (``gc.freeze``) before the first block stay frozen.
    """
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
