"""Describe the options of a driver: the keywords of ``Robot(...)`` for one robot."""

from __future__ import annotations

import types
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import msgspec

from strands_actors.contract.driver import Driver
from strands_actors.contract.options import Meanings


class OptionFacts(NamedTuple):
    """One keyword of a driver."""

    name: str
    other_name: str
    type: str
    default: str
    about: str


def options_of(driver: type[Driver]) -> list[OptionFacts]:
    """Return the keywords of a driver besides ``port``, with their types and defaults."""
    meanings = driver.OPTIONS
    if not isinstance(meanings, Meanings):
        raise TypeError(f"{driver.__name__}.OPTIONS is not made by meanings()")
    hints = get_type_hints(meanings.options, include_extras=True)
    others = {own: other for other, own in driver.SPELLINGS.items()}
    found = []
    for field in msgspec.structs.fields(meanings.options):
        name = field.encode_name
        about = meanings[name].rpartition("; default ")[0]
        kind = type_text(hints[field.name]) + "".join(_bounds(hints[field.name]))
        found.append(OptionFacts(name, others.get(name, ""), kind, default_text(field), about))
    return found


def default_text(field: msgspec.structs.FieldInfo) -> str:
    """Return the default of an option as source code."""
    if field.default is not msgspec.NODEFAULT:
        return repr(field.default)
    return repr(field.default_factory()) if field.default_factory is not msgspec.NODEFAULT else ""


def _bounds(hint: object) -> Iterator[str]:
    for meta in getattr(hint, "__metadata__", ()):
        for sign, bound in ((">", meta.gt), ("≥", meta.ge), ("<", meta.lt), ("≤", meta.le)):
            if bound is not None:
                yield f", {sign} {bound:g}"


def type_text(hint: object) -> str:
    """Return a type as a reader knows it, without annotations: ``int``, ``"a" or "b"``, ``float or None``."""
    if hint is types.NoneType:
        return "None"
    origin, arguments = get_origin(hint), get_args(hint)
    if hasattr(hint, "__metadata__"):
        return type_text(arguments[0])
    if origin is Literal:
        return " or ".join(f'"{value}"' if isinstance(value, str) else repr(value) for value in arguments)
    if origin in (Union, types.UnionType):
        return " or ".join(map(type_text, arguments))
    if origin is tuple:
        inner = [type_text(each) for each in arguments if each is not Ellipsis]
        return f"sequence of {inner[0]}" if len(set(inner)) == 1 else f"({', '.join(inner)})"
    if origin is list:
        return f"sequence of {type_text(arguments[0])}"
    if origin is dict:
        return f"mapping of {type_text(arguments[0])} to {type_text(arguments[1])}"
    return "any" if hint is Any else str(getattr(hint, "__name__", hint))
