"""Whether something that was sent as a tool's input, or over the mesh, asks for a stop, in whatever form. Pure.

A model, a gateway or a person sends a stop as an object, as JSON text, as an object within another,
in a list, in another case, or as a sentence of stop words alone. Each is understood. Nothing else
is: a motion in another form than the declared one is refused.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import msgspec


def _words(text: str) -> frozenset[str]:
    return frozenset(re.findall(r"[a-z_]+", text))


STOPS = _words("stop halt estop")
KEYS = _words(
    "action command verb tool name input inputs arguments args parameters params tool_input function call"
)
"""Keys whose value says what is asked for."""
BESIDE = KEYS | _words(
    """function type do please now immediately at once e emergency the this my your all everything every motor
    motors robot arm moving motion it json true none null"""
)
"""Words that change nothing of a stop."""
LONGEST = 400
"""Characters: whoever says more than this says more than stop."""
LONGEST_JSON = 4096
DEEPEST = 5
WIDEST = 64


def asks_for_stop(given: object, depth: int = 0) -> bool:
    """Return whether ``given`` asks for a stop and for nothing else."""
    if depth > DEEPEST:
        return False
    match given:
        case bytes():
            return asks_for_stop(given[: LONGEST_JSON + 1].decode("utf-8", "replace"), depth)
        case str():
            return _is_stop(given) or _is_stop_as_json(given, depth)
        case Mapping():
            if any(
                isinstance(key, str) and _is_stop(key) and value not in (False, 0) for key, value in given.items()
            ):
                return True
            said = [given[key] for key in given if isinstance(key, str) and key.strip().lower() in KEYS]
            return any(asks_for_stop(value, depth + 1) for value in said)
        case list() | tuple():
            return any(asks_for_stop(value, depth + 1) for value in given[:WIDEST])
    return False


def _is_stop(text: str) -> bool:
    if len(text) > LONGEST:
        return False
    words = set(re.findall(r"[a-z]+", text.lower()))
    return bool(words & STOPS) and words <= STOPS | BESIDE


def _is_stop_as_json(text: str, depth: int) -> bool:
    if len(text) > LONGEST_JSON or text.lstrip()[:1] not in ("{", "[", '"'):
        return False
    try:
        return asks_for_stop(msgspec.json.decode(text), depth + 1)
    except (msgspec.DecodeError, RecursionError):
        return False  # it says nothing
