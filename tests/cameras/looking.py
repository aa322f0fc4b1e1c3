"""Wait for events in the tests of cameras. The pauses leave the processor to the process that renders."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

PATIENCE_S = 90.0
"""Long, because a camera's process computes only when the others leave it time."""


def until(look: Callable[[], T | None], what: str) -> T:
    """Call ``look`` every 30 ms until its result is true, and return that result."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not (seen := look()):
        assert time.monotonic() < deadline_s, f"not within {PATIENCE_S:g} s: {what}"
        time.sleep(0.03)
    return seen
