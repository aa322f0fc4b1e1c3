"""What a writer sends is made plain before it travels: numbers of any library, keys of any type."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any

from strands_actors.contract.shown import harmless, shown
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

MAX_KEYS = 256
"""Of an action, or of one of its values."""
SHOWN = 100
"""Characters of a key or value that are sent on, for the refusal to show."""


def plain(action: Mapping[str, Any]) -> dict[str, Any]:
    """Ready to be sent: a number a key, or a few with names of their own. What is neither goes as
    its text, to be refused by name."""
    return {_text(key): _plain_value(value) for key, value in action.items()}


def refuse_shape(action: object) -> Refused | None:
    if isinstance(action, Mapping):
        if len(action) <= MAX_KEYS:
            return None
        what = f"the action has {len(action)} keys"
        return Refused(Code.TOO_MANY_KEYS, what, f"give at most {MAX_KEYS}", str(len(action)), str(MAX_KEYS))
    kind = type(action).__name__
    return Refused(Code.NOT_A_MAPPING, f"the action is a {kind}", "it must be a mapping of joints to numbers")


def _plain_value(value: Any) -> Any:
    if isinstance(value, Mapping):
        parts = itertools.islice(value.items(), MAX_KEYS)  # the rest is no part of anything: refused by name
        return {_text(name): _number_or_text(part) for name, part in parts}
    return _number_or_text(value)


def _number_or_text(value: Any) -> float | bool | str | None:
    """Return a number of any library as Python's own. A bool stays one, numpy's too: it is no
    number to the driver."""
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
    """Return a key as it is; one that cannot be sent, or would not be seen as it is, written
    out."""
    return harmless(key[:SHOWN]) if isinstance(key, str) else shown(key, SHOWN)
