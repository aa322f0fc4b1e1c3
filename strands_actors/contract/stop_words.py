"""Recognise a request to stop, in any form, in the input of a tool or in a message from the network. Pure.

A model, a gateway or a person may send a stop as an object, as JSON text or nearly JSON, as an object within
another, in a list, in upper or lower case, or as a sentence of stop words only. All of these are accepted as a
stop. Only stops are recognised in free form: a motion must have the declared form, or it is refused. If an object
names another verb, a text next to that verb does not make it a stop.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping

import msgspec


def _set(text: str) -> frozenset[str]:
    return frozenset(text.split())


STOPS = _set("stop halt estop")
VERB_KEYS = _set("action command cmd verb op operation intent")
"""Words of a key that has the verb as its value."""
INPUT_KEYS = _set(
    """tool tools name input inputs argument arguments args parameter parameters params function call calls use
    type method text message msg content contents request payload body data task instruction prompt value"""
)
"""Words of a key that may have the whole request as its value."""
BESIDE = _set(
    """action command verb tool tools name input inputs argument arguments args parameter parameters params function
    type call calls use do please now immediately at once asap urgent urgently e emergency soft hard quick safe full
    the this my your its all everything every motor motors robot robots arm arms joint joints moving motion motions
    movement it and i you we must can could want need to hey ok json python true none null"""
)
"""Words that do not change the meaning of a stop. The robot's own names and numbers do not either."""
NO = _set("false no off n f 0")
"""Values of a flag that is not set."""
ANY, IN_KEYS, INPUTS = STOPS | BESIDE, INPUT_KEYS | BESIDE, INPUT_KEYS - {"name"}
LONGEST, LONGEST_JSON = 4096, 16384
"""The most characters. A longer text asks for more than a stop. JSON may contain a long reason."""
LONGEST_KEY = 40
DEEPEST = 5
WIDEST = 64

_PAIR = re.compile(r"""\b(\w{1,40})["']?\s*[:=]\s*["']([^"']*)["']?""")
_LOCKING = re.compile(r"(?<![a-z])(e[^a-z]{0,3}stop|emergency([-_ ]?stop)?)(?![a-z])")
_WORD = re.compile(r"[^\W_]+")
_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])")


def asks_for_stop(message: object, names: str = "", depth: int = 0) -> bool:
    """Return True if ``message`` requests a stop and nothing else.

    Args:
        message: The input or message.
        names: The names of the robot, which may occur in the request.
        depth: The depth of nesting, which is limited.
    """
    if depth > DEEPEST:
        return False
    match message:
        case bytes() | bytearray() | memoryview():
            return asks_for_stop(bytes(message[: LONGEST_JSON + 1]).decode("utf-8", "replace"), names, depth)
        case str():
            return (
                _is_stop(message, names)
                or _is_stop_as_json(message, names, depth)
                or _is_pairs(message, names, depth)
            )
        case Mapping():
            return _is_stop_as_object(message, names, depth)
        case list() | tuple() | set() | frozenset():
            return any(asks_for_stop(value, names, depth + 1) for value in [*message][:WIDEST])
    return False


def names_estop(text: str) -> bool:
    """Return True if ``text`` requests an e-stop, a stop that also locks the robot."""
    return bool(_LOCKING.search(text.lower()))


def _words(text: str) -> set[str]:
    plain = text if text.isascii() else unicodedata.normalize("NFKC", text)
    return {word for word in _WORD.findall(_HUMP.sub(" ", plain).lower()) if not word.isdigit()}


def _add_nothing(words: set[str], names: str) -> bool:
    more = words - ANY
    return not more or more <= _words(names)


def _changes_nothing(text: str, names: str) -> bool:
    return len(text) <= LONGEST and _add_nothing(_words(text), names)


def _is_stop(text: str, names: str) -> bool:
    return len(text) <= LONGEST and _are_stop(_words(text), names)


def _are_stop(words: set[str], names: str) -> bool:
    return bool(words & STOPS) and _add_nothing(words, names)


def _is_stop_as_object(message: Mapping[object, object], names: str, depth: int) -> bool:
    words = {key: _words(key) for key in message if isinstance(key, str) and len(key) <= LONGEST_KEY}
    verbs = [message[key] for key in words if words[key] & VERB_KEYS and not words[key] & INPUTS]
    if any(asks_for_stop(value, names, depth + 1) for value in verbs):
        return True
    names_another = any(isinstance(value, str) and not _changes_nothing(value, names) for value in verbs)
    if any(_are_stop(words[key], names) and _is_set(message[key], not names_another) for key in words):
        return True
    others = [message[key] for key in words if words[key] and words[key] <= IN_KEYS]
    return any(
        asks_for_stop(value, names, depth + 1) for value in others if not (names_another and isinstance(value, str))
    )


def _is_set(value: object, if_empty: bool) -> bool:
    """Return True if this value of a flag, such as ``true`` in ``{"stop": true}``, sets the flag.

    ``if_empty`` is the result for an empty value.
    """
    match value:
        case str() if value.strip():
            return value.strip().lower() not in NO
        case bool() | int() | float():
            return bool(value)
        case Mapping() | list() | tuple():
            return if_empty or len(value) > 0
    return if_empty


def _is_stop_as_json(text: str, names: str, depth: int) -> bool:
    """Return True if the text contains JSON that requests a stop.

    A code fence, a tag or a stop word may surround the JSON.
    """
    begin = min((index for index in map(text.find, '{["') if index >= 0), default=-1)
    end = max(map(text.rfind, '}]"')) + 1
    if begin < 0 or end - begin > LONGEST_JSON or not _changes_nothing(f"{text[:begin]} {text[end:]}", names):
        return False
    try:
        return asks_for_stop(msgspec.json.decode(text[begin:end]), names, depth + 1)
    except (msgspec.DecodeError, RecursionError):
        return False  # the text is not JSON


def _is_pairs(text: str, names: str, depth: int) -> bool:
    """Return True if the text is a call, or nearly a JSON object, and requests a stop.

    Such an object is in single quotes, is cut off, or has an extra comma.
    """
    pairs = _PAIR.findall(text) if len(text) <= LONGEST else []
    beside = _changes_nothing(_PAIR.sub(" ", text), names) if pairs else False
    return beside and asks_for_stop(dict(pairs), names, depth + 1)
