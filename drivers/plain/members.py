"""Read the declarations of a user's driver class, and interpret its answers. Pure.

The drivers page defines no member that names a robot's axes: a class accepts any mapping in
``send_action`` and checks it itself. So axes come from, in this order:

1. ``action_features`` of the class or of an object of it, the name that LeRobot's robots use: a mapping
   of keys, or the keys.
2. the first observation: its keys with numbers. If any key ends in ``.pos``, only those, since other
   readings beside positions (``.vel``, temperatures) cannot be commanded.

Limits that the class declares are enforced. Without a declaration no limit is assumed:
``action_limits`` (key to lowest and highest), ``action_speeds`` (key to units a second, for streams),
``action_units`` (one word, or key to word), ``action_lifetime_s`` (seconds after which a command ends;
without it, when its writer is gone) and ``control_hz``.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable, Mapping
from typing import Any

import msgspec

FEATURES = "action_features"
OBSERVED = "the first observation"
CONTROL_HZ = 30.0
FASTEST_HZ = 250.0
"""Highest rate of blocking calls from a thread. Above it the calls themselves take all the time."""


class Declared(msgspec.Struct, frozen=True):
    """The axes that a class declares. ``keys``: as the class spells them; ``source``: where they come
    from."""

    keys: tuple[str, ...] = ()
    source: str = ""
    limits: dict[str, tuple[float, float]] = msgspec.field(default_factory=dict)
    speeds: dict[str, float] = msgspec.field(default_factory=dict)
    units: dict[str, str] = msgspec.field(default_factory=dict)
    unit: str = ""  # of axes that ``units`` does not name
    lifetime_s: float | None = None
    control_hz: float = CONTROL_HZ


def declared_by(thing: Any, name: str) -> Declared:
    """Return the declarations of a class, or of an object of it.

    Raises:
        ValueError: A declaration is wrong. The text names the accepted values.
    """
    keys = _keys(_member(thing, FEATURES), name)
    given_units = _member(thing, "action_units")
    if given_units is not None and not isinstance(given_units, str | Mapping):
        raise ValueError(f"{name}.action_units is {given_units!r}. Give one word, or a mapping of keys to words")
    declared = Declared(
        keys,
        FEATURES if keys else "",
        {
            key: _limits(limits, f"{name}.action_limits[{key!r}]")
            for key, limits in _rows(thing, "action_limits", name)
        },
        {
            key: _above_zero(speed, f"{name}.action_speeds[{key!r}]")
            for key, speed in _rows(thing, "action_speeds", name)
        },
        dict(_rows(thing, "action_units", name)) if isinstance(given_units, Mapping) else {},
        given_units if isinstance(given_units, str) else "",
        _optional(_member(thing, "action_lifetime_s"), f"{name}.action_lifetime_s"),
        _hz(_member(thing, "control_hz"), f"{name}.control_hz"),
    )
    if keys:
        require_axes(declared, name)
    return declared


def require_axes(declared: Declared, name: str) -> None:
    """Raise ``ValueError`` for a limit of an unknown axis: a misspelt key would limit nothing."""
    spellings = {spelling for key in declared.keys for spelling in (key, key.removesuffix(".pos"))}
    tables: dict[str, Mapping[str, Any]] = {
        "action_limits": declared.limits,
        "action_speeds": declared.speeds,
        "action_units": declared.units,
    }
    for member, table in tables.items():
        for key in table:
            if key not in spellings:
                axes = ", ".join(declared.keys)
                raise ValueError(f"{name}.{member} names {key!r}, which is no axis. It has {axes}")


def keys_of(observation: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the keys of an observation that are axes: those with a number, or only positions if there are
    any."""
    keys = [key for key, value in observation.items() if isinstance(key, str) and number(value) is not None]
    return tuple([key for key in keys if key.endswith(".pos")] or keys)


SENSED: Mapping[str, tuple[str, ...]] = {
    "pose": ("_pose", "_slam_pose", "_odom_pose"),
    "imu": ("_imu",),
    "odom": ("_odom",),
    "battery": ("_battery",),
    "lidar/summary": ("_lidar_summary",),
    "lidar/state": ("_lidar_state",),
}
"""Topic of the mesh to the members that it is read from. The first member with a value counts."""

MOST_FIELDS = 32
LONGEST_ROW = 16


def rows_of(topic: str, record: Any) -> dict[str, tuple[float, ...]]:
    """Return the numbers of a sensor's record under ``<topic>.<field>``. Only numbers and short rows of
    numbers are taken. The record of a battery may be its charge alone."""
    if topic == "battery" and number(record) is not None:
        record = {"pct": record}
    if not isinstance(record, Mapping):
        return {}
    rows = {f"{topic}.{field}": row for field, value in record.items() if (row := _row(value))}
    return dict(list(rows.items())[:MOST_FIELDS])


def _row(value: Any) -> tuple[float, ...]:
    """Return a number, or a row of numbers of any library, as floats; empty for other values."""
    value = value.tolist() if callable(getattr(value, "tolist", None)) else value
    parts = value if isinstance(value, list | tuple) else [value]
    numbers_ = [number(part) for part in parts]
    finite = tuple(part for part in numbers_ if part is not None)
    return finite if 0 < len(finite) == len(parts) <= LONGEST_ROW else ()


def number(value: Any) -> float | None:
    """Return a number of any library as a finite float, else None."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return None
    return float(value) if math.isfinite(value) else None


def failure_of(answer: Any) -> str:
    """Return why an answer of the class means failure; empty if it means success.

    Failures are the page's envelope with the status ``error``, a block
    ``{"stopped": false, "reason": ...}``, and False. None and every other value mean success, since the
    class did not raise.
    """
    if answer is False:
        return "it answered False"
    if not isinstance(answer, Mapping):
        return ""
    content = answer.get("content")
    blocks = [block for block in content if isinstance(block, Mapping)] if isinstance(content, list | tuple) else []
    details = [block["json"] for block in blocks if isinstance(block.get("json"), Mapping)]
    reasons = [
        str(json.get("reason") or "it says that it has not stopped")
        for json in details
        if json.get("stopped") is False
    ]
    if answer.get("status") == "error":
        texts = [str(block["text"]) for block in blocks if "text" in block]
        return "; ".join(texts or reasons) or "it answered with an error"
    return "; ".join(reasons)


def _member(thing: Any, name: str) -> Any:
    """Return a member that is data. None for a property of a class, which has no value yet."""
    value = getattr(thing, name, None)
    return None if isinstance(value, property) or callable(value) else value


def _keys(features: Any, name: str) -> tuple[str, ...]:
    if features is None:
        return ()
    if isinstance(features, str) or not isinstance(features, Iterable):
        raise ValueError(f"{name}.{FEATURES} is {features!r}. Give a mapping of keys, or the keys")
    given = dict(features) if isinstance(features, Mapping) else dict.fromkeys(features)
    keys = tuple(key for key, kind in given.items() if not isinstance(kind, tuple | list))  # a shape: a picture
    if wrong := [key for key in keys if not isinstance(key, str) or not key]:
        raise ValueError(f"{name}.{FEATURES} has the key {wrong[0]!r}. Keys are text")
    return keys


def _rows(thing: Any, member: str, name: str) -> list[tuple[str, Any]]:
    given = _member(thing, member)
    if given is None:
        return []
    if not isinstance(given, Mapping):
        raise ValueError(f"{name}.{member} is {given!r}. Give a mapping of keys")
    return [(str(key), value) for key, value in given.items()]


def _limits(given: Any, where: str) -> tuple[float, float]:
    ends = [number(end) for end in given] if isinstance(given, tuple | list) else []
    if len(ends) == 2 and ends[0] is not None and ends[1] is not None and ends[0] < ends[1]:
        return ends[0], ends[1]
    raise ValueError(f"{where} is {given!r}. Give the lowest and the highest, finite")


def _above_zero(given: Any, where: str) -> float:
    value = number(given)
    if value is None or value <= 0:
        raise ValueError(f"{where} is {given!r}. Give a finite number above 0")
    return value


def _optional(given: Any, where: str) -> float | None:
    return None if given is None else _above_zero(given, where)


def _hz(given: Any, where: str) -> float:
    hz = CONTROL_HZ if given is None else _above_zero(given, where)
    if hz > FASTEST_HZ:
        raise ValueError(f"{where} is {given!r}. Give at most {FASTEST_HZ:g}")
    return hz
