"""Read the declarations of a user's driver class, and interpret the answers of its methods. Pure.

``docs/drivers.md`` defines no member that names a robot's axes, since a class accepts any mapping in
``send_action`` and checks it itself. So this module finds the axes in one of these ways, tried in this order:

1. ``action_features`` of the class or of an object. LeRobot's robots have it, too. It is a mapping of keys, or a
   list of keys.
2. The keys of the first observation that have a number. If any key ends in ``.pos``, only such keys are axes, since
   other readings (``.vel``, temperatures) cannot be commanded.

A class may also declare limits. Without a declaration there is no limit:

* ``action_limits``: key to lowest and highest value.
* ``action_speeds``: key to the highest speed in units per second, for streams.
* ``action_units``: one unit, or key to unit.
* ``action_lifetime_s``: seconds after which a command ends. Without it, a command ends with its writer.
* ``control_hz``: the control rate.
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
"""Highest control rate. At a higher rate, calling the class in a thread would take all the time."""


class Declared(msgspec.Struct, frozen=True):
    """The axes that a class declares, and their limits. ``keys`` are the keys as the class spells them. ``source``
    names the member that they were read from."""

    keys: tuple[str, ...] = ()
    source: str = ""
    limits: dict[str, tuple[float, float]] = msgspec.field(default_factory=dict)
    speeds: dict[str, float] = msgspec.field(default_factory=dict)
    units: dict[str, str] = msgspec.field(default_factory=dict)
    unit: str = ""  # unit of the axes that ``units`` does not name
    lifetime_s: float | None = None
    control_hz: float = CONTROL_HZ


def declared_by(thing: Any, name: str) -> Declared:
    """Return the declarations of a class, or of an object of it.

    Raises:
        ValueError: A declaration is invalid. The message names the accepted values.
    """
    keys = _keys(_member(thing, FEATURES), name)
    units = _member(thing, "action_units")
    if units is not None and not isinstance(units, str | Mapping):
        raise ValueError(f"{name}.action_units is {units!r}. Give one word, or a mapping of keys to words")
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
        dict(_rows(thing, "action_units", name)) if isinstance(units, Mapping) else {},
        units if isinstance(units, str) else "",
        _optional(_member(thing, "action_lifetime_s"), f"{name}.action_lifetime_s"),
        _hz(_member(thing, "control_hz"), f"{name}.control_hz"),
    )
    if keys:
        require_axes(declared, name)
    return declared


def require_axes(declared: Declared, name: str) -> None:
    """Raise ``ValueError`` if a limit, speed or unit names an axis that does not exist. A misspelt key would
    otherwise have no effect."""
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
                raise ValueError(f"{name}.{member} names {key!r}, which is no axis. Use one of {axes}")


def keys_of(observation: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the keys of an observation that are axes. These are the keys with a number. If any of these keys
    ends in ``.pos``, return only the keys that end in ``.pos``."""
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
"""For each topic of the mesh, the attributes that may have its value. The first attribute with a value is used."""

MOST_FIELDS = 32
LONGEST_ROW = 16


def rows_of(topic: str, record: Any) -> dict[str, tuple[float, ...]]:
    """Return the numbers of a sensor's record, with keys ``<topic>.<field>``. Only numbers and short lists of
    numbers are used. For a battery, the record may also be a number, the charge."""
    if topic == "battery" and number(record) is not None:
        record = {"pct": record}
    if not isinstance(record, Mapping):
        return {}
    rows = {f"{topic}.{field}": row for field, value in record.items() if (row := _row(value))}
    return dict(list(rows.items())[:MOST_FIELDS])


def _row(value: Any) -> tuple[float, ...]:
    """Return a number or a list of numbers as floats. The numbers may be of any library. Empty for other values."""
    value = value.tolist() if callable(getattr(value, "tolist", None)) else value
    parts = value if isinstance(value, list | tuple) else [value]
    numbers_ = [number(part) for part in parts]
    finite = tuple(part for part in numbers_ if part is not None)
    return finite if 0 < len(finite) == len(parts) <= LONGEST_ROW else ()


def number(value: Any) -> float | None:
    """Return a number of any library as a finite float; None for other values."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return None
    return float(value) if math.isfinite(value) else None


def failure_of(answer: Any) -> str:
    """Return the reason if an answer of the class means a failure; empty if it means success.

    A failure is a mapping with the status ``error``, a block ``{"stopped": false, "reason": ...}`` in its content,
    or False. None and every other value mean success, since the class did not raise an exception.
    """
    if answer is False:
        return "it returned False"
    if not isinstance(answer, Mapping):
        return ""
    content = answer.get("content")
    blocks = [block for block in content if isinstance(block, Mapping)] if isinstance(content, list | tuple) else []
    details = [block["json"] for block in blocks if isinstance(block.get("json"), Mapping)]
    reasons = [
        str(json.get("reason") or "it reports that the robot has not stopped")
        for json in details
        if json.get("stopped") is False
    ]
    if answer.get("status") == "error":
        texts = [str(block["text"]) for block in blocks if "text" in block]
        return "; ".join(texts or reasons) or "it returned an error"
    return "; ".join(reasons)


def _member(thing: Any, name: str) -> Any:
    """Return an attribute that is data; None for a method, and for a property of a class without an object."""
    value = getattr(thing, name, None)
    return None if isinstance(value, property) or callable(value) else value


def _keys(features: Any, name: str) -> tuple[str, ...]:
    if features is None:
        return ()
    if isinstance(features, str) or not isinstance(features, Iterable):
        raise ValueError(f"{name}.{FEATURES} is {features!r}. Give a mapping with the keys, or a list of keys")
    declared = dict(features) if isinstance(features, Mapping) else dict.fromkeys(features)
    # In LeRobot's features, a tuple is the shape of a picture, so its key is no axis.
    keys = tuple(key for key, value in declared.items() if not isinstance(value, tuple | list))
    if wrong := [key for key in keys if not isinstance(key, str) or not key]:
        raise ValueError(f"{name}.{FEATURES} has the key {wrong[0]!r}. Give keys that are text")
    return keys


def _rows(thing: Any, member: str, name: str) -> list[tuple[str, Any]]:
    declared = _member(thing, member)
    if declared is None:
        return []
    if not isinstance(declared, Mapping):
        raise ValueError(f"{name}.{member} is {declared!r}. Give a mapping of keys to values")
    return [(str(key), value) for key, value in declared.items()]


def _limits(declared: Any, label: str) -> tuple[float, float]:
    ends = [number(end) for end in declared] if isinstance(declared, tuple | list) else []
    if len(ends) == 2 and ends[0] is not None and ends[1] is not None and ends[0] < ends[1]:
        return ends[0], ends[1]
    raise ValueError(f"{label} is {declared!r}. Give two finite numbers, the lowest and the highest value")


def _above_zero(declared: Any, label: str) -> float:
    value = number(declared)
    if value is None or value <= 0:
        raise ValueError(f"{label} is {declared!r}. Give a finite number above 0")
    return value


def _optional(declared: Any, label: str) -> float | None:
    return None if declared is None else _above_zero(declared, label)


def _hz(declared: Any, label: str) -> float:
    hz = CONTROL_HZ if declared is None else _above_zero(declared, label)
    if hz > FASTEST_HZ:
        raise ValueError(f"{label} is {declared!r}. Give at most {FASTEST_HZ:g}")
    return hz
