"""Compute the hash of a ROS type (RIHS01), which is part of each key since ROS 2 Jazzy. Pure.

The hash is SHA-256 of the type's description as JSON: its fields, and those of all types in them. So two programs
with different definitions of a type never exchange messages of it.
"""

from __future__ import annotations

import functools
import hashlib
import json
from typing import Any

from .definitions import ARRAY, BOUNDED, SEQUENCE, SERVICES, SINGLE, Fields, fields_of, parse_type

UNSUPPORTED = "TypeHashNotSupported"
"""Stands in the place of a hash in ROS 2 Humble, which has no hashes."""

_NESTED = 1
_IDS = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "char": 13,
    "bool": 15,
    "byte": 16,
    "string": 17,
}
"""The number of each basic type in type_description_interfaces/msg/FieldType."""
_OFFSETS = {SINGLE: 0, ARRAY: 48, BOUNDED: 96, SEQUENCE: 144}
"""The number of an array's type is that of its elements, plus this."""


@functools.cache
def type_hash(name: str) -> str:
    """Return the hash of a message or service, as ``RIHS01_`` with 64 hexadecimal digits.

    Raises:
        KeyError: The table of definitions has no such type.
    """
    description = {
        "type_description": _description(name),
        "referenced_type_descriptions": [_description(other) for other in sorted(_referenced(name))],
    }
    return f"RIHS01_{hashlib.sha256(json.dumps(description).encode()).hexdigest()}"


def dds_name(name: str) -> str:
    """Return the name of a type on the wire: ``std_msgs/msg/String`` is ``std_msgs::msg::dds_::String_``."""
    package, kind, own = name.split("/")
    return f"{package}::{kind}::dds_::{own}_"


def _fields(name: str) -> Fields:
    if name in SERVICES:  # A service is described as a type with three fields.
        parts = {"request_message": "Request", "response_message": "Response", "event_message": "Event"}
        return {field: f"{name}_{part}" for field, part in parts.items()}
    return fields_of(name)


def _referenced(name: str) -> set[str]:
    names: set[str] = set()
    for text in _fields(name).values():
        base = parse_type(text).base
        if base not in _IDS:
            names |= {base} | _referenced(base)
    return names


def _description(name: str) -> dict[str, Any]:
    fields = [{"name": field, "type": _type(text)} for field, text in _fields(name).items()]
    return {"type_name": name, "fields": fields}


def _type(text: str) -> dict[str, Any]:
    field = parse_type(text)
    number = _IDS.get(field.base, _NESTED) + _OFFSETS[field.kind]
    return {
        "type_id": number,
        "capacity": field.size,
        "string_capacity": 0,
        "nested_type_name": "" if field.base in _IDS else field.base,
    }
