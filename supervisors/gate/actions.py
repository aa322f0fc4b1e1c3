"""Convert an action to plain Python values before it is sent to another process.

Scripts give numbers of any library (numpy, torch) and keys of any type.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any

from strands_actors.contract.shown import harmless, shown
from strands_actors.kernel.messages import Refused

from . import refusals

MAX_KEYS = 256
"""Most keys of an action, or of one of its values."""
SHOWN = 100
"""Longest text of a key or value that is sent to the gate. A refusal shows this text."""


def plain(action: Mapping[str, Any]) -> dict[str, Any]:
    """Return an action that can be sent to another process.

    Args:
        action: For each key a number, or a mapping of names to numbers.

    Returns:
        The action with Python's own numbers. Any other value becomes text, so that the gate can refuse it and name
        its key.
    """
    return {_text(key): _plain_value(value) for key, value in action.items()}


def refuse_shape(action: object) -> Refused | None:
    """Return a refusal if an action is no mapping or has too many keys; otherwise None."""
    if isinstance(action, Mapping):
        if len(action) <= MAX_KEYS:
            return None
        return refusals.too_many_keys(len(action), MAX_KEYS)
    return refusals.not_a_mapping(type(action).__name__)


def _plain_value(value: Any) -> Any:
    if isinstance(value, Mapping):
        # No robot has so many axes, so further values cannot be valid.
        parts = itertools.islice(value.items(), MAX_KEYS)
        return {_text(name): _number_or_text(part) for name, part in parts}
    return _number_or_text(value)


def _number_or_text(value: Any) -> float | bool | str | None:
    """Return a number of any library as a Python number. A bool stays a bool, so that the driver can refuse it."""
    if value is None or isinstance(value, str):
        return value and harmless(value[:SHOWN])
    item = getattr(value, "item", None)
    try:
        value = item() if callable(item) else value
        return value if isinstance(value, bool) else float(value)
    except OverflowError:
        return math.inf
    except (TypeError, ValueError, RuntimeError):
        return shown(value, SHOWN)


def _text(key: object) -> str:
    """Return a key as text. Characters that cannot be sent or shown are written as escapes."""
    return harmless(key[:SHOWN]) if isinstance(key, str) else shown(key, SHOWN)
