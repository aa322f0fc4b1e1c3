"""Convert numbers and truth values of any library to Python's types."""

from __future__ import annotations

from typing import Any


def as_python(value: Any) -> Any:
    """Return a scalar of numpy, torch or the like as a Python bool, int or float.

    Any other value is returned unchanged.
    """
    item = getattr(value, "item", None)
    if not callable(item) or getattr(value, "ndim", 0) != 0:
        return value
    try:
        return item()
    except (TypeError, ValueError, RuntimeError):  # a tensor without data cannot be converted
        return value


__all__ = ["as_python"]
