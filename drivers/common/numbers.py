"""What counts as a number in an action."""

from __future__ import annotations

import math


def finite(value: object) -> float | None:
    """As a float; None for what is none: text, a bool, infinite, not a number, too large."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
