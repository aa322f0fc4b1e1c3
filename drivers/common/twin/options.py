"""Options of a simulated robot as a struct, like the options of a driver. Type, range and meaning of an option are
defined in one place.

Values may be text from a command line. The text ``arm=false`` is parsed as False, although it is not empty.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from strands_actors.contract.options import DriverOptions, convert_options, option


class TwinOptions(DriverOptions, frozen=True):
    """Base of the options of a simulated robot. Every option has a default."""


class HostOption(TwinOptions, frozen=True):
    """The option ``host`` of a simulated robot in a network. A robot with fixed port numbers has no option
    ``port``."""

    host: Annotated[str | None, option("address to serve at; None: one of its own in 127.0.0.0/8")] = None


Port = Annotated[int, option("port to serve at; 0: any free one", ge=0, le=65535)]


class NetworkOptions(HostOption, frozen=True):
    """The options ``host`` and ``port`` of a simulated robot in a network."""

    port: Port = 0


OptionsT = TypeVar("OptionsT", bound=TwinOptions)


def read_twin_options(robot: str, options: type[OptionsT], keywords: Mapping[str, Any] | None) -> OptionsT:
    """Convert the keyword arguments of a simulated robot's ``main`` into its options struct.

    Args:
        robot: The robot's name, for error messages.
        options: The type of the struct.
        keywords: The keyword arguments. A number or a bool may be text.

    Raises:
        ValueError: An option does not exist, or a value is not accepted.
    """
    try:
        return convert_options(robot, options, keywords or {}, from_text=True)
    except TypeError as unknown:
        raise ValueError(str(unknown)) from None


__all__ = ["HostOption", "NetworkOptions", "OptionsT", "Port", "TwinOptions", "read_twin_options"]
