"""Declare the constructor keywords of a driver (its options) as a msgspec struct.

The annotation of a field contains the option's type, range and meaning.

::

    class Options(DriverOptions, frozen=True):
        baud: Annotated[Literal[1_000_000, 500_000], option("speed of the bus")] = 1_000_000
        timeout_s: Annotated[float, option("longest wait for an answer", gt=0, le=60)] = 10.0
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from .plain_numbers import as_python
from .shown import closest

ALWAYS = ("tool_name",)
"""Keywords that every driver gets."""


class DriverOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the options of a driver. Every field has a default."""


Options = TypeVar("Options", bound=DriverOptions)


def option(about: str, *, secret: bool = False, is_path: bool = False, **constraints: Any) -> msgspec.Meta:
    """Describe an option, within the annotation of a field.

    Args:
        about: The meaning of the option, for people.
        secret: True if the value must never be shown, recorded or hashed (a password).
        is_path: True if the value may also be given as a path object.
        constraints: Constraints of msgspec: ``gt``, ``ge``, ``lt``, ``le``, ``pattern``, ``min_length``.
    """
    return msgspec.Meta(description=about, extra={"secret": secret, "is_path": is_path}, **constraints)


def secrets_of(options: type[DriverOptions]) -> frozenset[str]:
    """Return the keywords with secret values (passwords), for ``Driver.SECRETS``."""
    hints = get_type_hints(options, include_extras=True)
    return frozenset(
        field.encode_name
        for field in msgspec.structs.fields(options)
        if any((meta.extra or {}).get("secret") for meta in getattr(hints[field.name], "__metadata__", ()))
    )


class Meanings(dict[str, str]):
    """The meaning and default of each keyword of ``options``."""

    def __init__(self, options: type[DriverOptions]) -> None:
        super().__init__()
        self.options = options


def meanings(options: type[DriverOptions]) -> Meanings:
    """Return the meaning and default of each keyword.

    The command ``list``, the option ``--help`` and the signatures of ``Robot`` show them.
    """
    result = Meanings(options)
    hints = get_type_hints(options, include_extras=True)
    for field in msgspec.structs.fields(options):
        texts = [meta.description for meta in getattr(hints[field.name], "__metadata__", ()) if meta.description]
        result[field.encode_name] = f"{'; '.join(texts)}; default {field.default!r}"
    return result


def read_options(robot: str, options: type[Options], offered: Mapping[str, Any]) -> Options:
    """Return a driver's options as a struct.

    Raises:
        TypeError: A keyword is unknown. The text suggests the nearest one.
        ValueError: A value is not accepted. The text lists the accepted values.
    """
    own = {
        name: value
        for name, value in offered.items()
        if name in options.__struct_encode_fields__ or name not in ALWAYS
    }
    return convert_options(robot, options, own)


def convert_options(
    robot: str, options: type[Options], offered: Mapping[str, Any], *, from_text: bool = False
) -> Options:
    """Return options as a struct. A keyword that ``options`` does not declare is refused.

    Args:
        robot: The robot's name, for the texts of exceptions.
        options: The class of the struct.
        offered: Values by keyword.
        from_text: True accepts numbers and bools as text, as from a command line.
    """
    names = [field.encode_name for field in msgspec.structs.fields(options)]
    values = {name: as_python(value) for name, value in offered.items()}
    if unknown := [name for name in values if name not in names]:
        close = closest(unknown[0], names)
        hint = f" ({unknown[0]!r} -> {close[0]!r}?)" if close else ""
        use = f"Use {', '.join(names)}" if names else "This robot takes no options"
        raise TypeError(f"{robot}: unknown option {', '.join(unknown)}{hint}. {use}")
    try:
        read = msgspec.convert(values, options, strict=not from_text)
    except msgspec.ValidationError as error:
        reason, _, path = str(error).rpartition(" - at `$.")
        name = path.removesuffix("`").partition("[")[0]
        shown = "not accepted" if name in secrets_of(options) else repr(values.get(name))
        raise ValueError(
            f"{robot}: {name} is {shown}. {_accepted_values(options, name)} ({reason or error})"
        ) from None
    for field in msgspec.structs.fields(options):
        number, name = getattr(read, field.name), field.encode_name
        if name in values and isinstance(number, float) and not math.isfinite(number):
            raise ValueError(f"{robot}: {name} is {values[name]!r}. {_accepted_values(options, name)}")
    return read


def plain(options: DriverOptions) -> dict[str, Any]:
    """Return the options as plain data, which can be sent to other processes and stored in recordings."""
    data: dict[str, Any] = msgspec.to_builtins(options)
    return data


def _accepted_values(options: type[DriverOptions], name: str) -> str:
    """Describe the accepted values of an option, for the text of a refusal."""
    if name not in (field.encode_name for field in msgspec.structs.fields(options)):
        return "Leave it out"
    choices = _choices(get_type_hints(options)[name])
    one_of = f", one of {', '.join(map(repr, choices))}" if choices else ""
    return f"It is: {meanings(options)[name]}{one_of}"


def _choices(hint: Any) -> tuple[Any, ...]:
    """Return the values of a ``Literal``; empty for another type."""
    return get_args(hint) if get_origin(hint) is Literal else ()
