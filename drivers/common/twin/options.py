"""Options of a twin as a struct, like those of a driver. Type, range and meaning stand in one place.

Values may be text from a command line. ``arm=false`` is parsed as False, not as a non-empty text.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from strands_actors.contract.options import DriverOptions, convert_options, option


class TwinOptions(DriverOptions, frozen=True):
    """Base of the options of a twin. Every field has a default."""


class HostOption(TwinOptions, frozen=True):
    """Options of a twin on a network with fixed ports."""

    host: Annotated[str | None, option("address to serve at; None: one of its own in 127.0.0.0/8")] = None


Port = Annotated[int, option("port to serve at; 0: any free one", ge=0, le=65535)]


class NetworkOptions(HostOption, frozen=True):
    """Options of a twin on a network."""

    port: Port = 0


Options = TypeVar("Options", bound=TwinOptions)


def read_twin_options(robot: str, options: type[Options], given: Mapping[str, Any] | None) -> Options:
    """Convert the options given to a twin's ``main`` into its struct.

    Args:
        robot: The robot's name, for error messages.
        options: The struct.
        given: The options. A number or a bool may be text.

    Raises:
        ValueError: An option does not exist, or a value is not accepted.
    """
    try:
        return convert_options(robot, options, given or {}, from_text=True)
    except TypeError as unknown:
        raise ValueError(str(unknown)) from None


__all__ = ["HostOption", "NetworkOptions", "Port", "TwinOptions", "read_twin_options"]
