"""What the tests of cameras wait for, in looks that leave the processor to who draws."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

PATIENCE_S = 90.0
"""A camera computes after everybody else."""


def until(look: Callable[[], T | None], what: str) -> T:
    """Look until there is something to see."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not (seen := look()):
        assert time.monotonic() < deadline_s, f"not within {PATIENCE_S:g} s: {what}"
        time.sleep(0.03)
    return seen
