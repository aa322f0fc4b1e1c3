"""Walk all messages of a protocol on a twin, without a network."""

from __future__ import annotations

import dataclasses
import enum
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from strands_actors.drivers.common.twin.modelled import Modelled

OURS = ("strands_actors", "tests")


@dataclasses.dataclass(frozen=True)
class Answer:
    """The twin's answer to one message."""

    accepted: bool
    """False for the vendor's own error, and for silence."""
    content: object = b""
    """What it says beyond success."""


@dataclasses.dataclass(frozen=True)
class Walk:
    """How the test sends each message of one table to a twin."""

    name: str
    table: Modelled[Any]
    keys: Iterable[Any]
    """All messages of the protocol, modelled or not."""
    world: Callable[[], Any]
    """Builds a twin on a clock that stands still."""
    ask: Callable[[Any, Any, Any], Answer]
    """Sends one message: the twin, the message's number or name, and its data."""
    requests: Mapping[Any, Any]
    """Valid data for each modelled message."""
    others: Sequence[Any]
    """Data with which each message that is not modelled is tried."""
    prepare: Mapping[Any, Callable[[Any], None]] = dataclasses.field(default_factory=dict)
    """Brings the twin into a state in which a message can have its effect."""
    without: frozenset[Any] = frozenset()
    """Modelled messages whose effect is not seen at once: the test that sees it is named where the walk is made."""


def fingerprint(value: Any, seen: frozenset[int] = frozenset()) -> object:
    """Return the whole state of an object of ours, to compare it with the state at another time."""
    if id(value) in seen:
        return "again"
    seen |= {id(value)}
    match value:
        case None | bool() | int() | float() | str() | bytes() | bytearray() | enum.Enum():
            return repr(value)
        case np.ndarray():
            return value.tobytes()
        case Mapping():
            return [(repr(key), fingerprint(each, seen)) for key, each in value.items()]
        case list() | tuple() | deque():
            return [fingerprint(each, seen) for each in value]
        case set() | frozenset():
            return sorted(map(repr, value))
    if hasattr(value, "qpos") and hasattr(value, "ctrl"):  # MuJoCo's data
        return value.qpos.tobytes(), value.qvel.tobytes(), value.ctrl.tobytes()
    if not type(value).__module__.startswith(OURS):
        return type(value).__name__
    names = [*getattr(value, "__dict__", ()), *getattr(type(value), "__struct_fields__", ())]
    names += [name for name in getattr(type(value), "__slots__", ()) if hasattr(value, name)]
    return [(name, fingerprint(getattr(value, name), seen)) for name in names]
