"""Options of a twin as a struct, as those of a driver are: types, ranges and meanings stand once.

They come as text from a command line, too: ``arm=false`` is no text that is true.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from strands_actors.contract.options import DriverOptions, convert_options, option


class TwinOptions(DriverOptions, frozen=True):
    """Base of the options of a twin. Every field has a default."""


class HostOption(TwinOptions, frozen=True):
    """Of a twin on a network whose ports are fixed."""

    host: Annotated[str | None, option("address to serve at; None: one of its own in 127.0.0.0/8")] = None


Port = Annotated[int, option("port to serve at; 0: any free one", ge=0, le=65535)]


class NetworkOptions(HostOption, frozen=True):
    """Of a twin on a network."""

    port: Port = 0


Options = TypeVar("Options", bound=TwinOptions)


def read_twin_options(robot: str, options: type[Options], given: Mapping[str, Any] | None) -> Options:
    """Return what a twin's ``main`` was given as a struct; a number or a bool may be text. Raise
    ``ValueError`` for an option that is not there, or a value that is not accepted."""
    try:
        return convert_options(robot, options, given or {}, from_text=True)
    except TypeError as unknown:
        raise ValueError(str(unknown)) from None


__all__ = ["HostOption", "NetworkOptions", "Port", "TwinOptions", "read_twin_options"]
