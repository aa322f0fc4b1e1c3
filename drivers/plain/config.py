"""The facts about a driver class that all processes of its robot share, and the timeouts for its methods."""

from __future__ import annotations

from typing import Any

import msgspec

from .class_location import ClassLocation
from .members import Declared

LATE_S = 0.5
"""How long a message to the robot may still take effect after the process that sent it was killed, in seconds
[assumed: on a local network]."""


class Deadlines(msgspec.Struct, frozen=True):
    """Timeouts of the methods of a user's driver object, in seconds."""

    connect_s: float = 5.0
    """Timeout for making and connecting the object, since the class may import an SDK there."""
    call_s: float = 0.5
    """Timeout for ``send_action`` and ``get_observation``. A stop waits for the running call, so this is also its
    longest delay."""
    stop_s: float = 1.0
    cleanup_s: float = 0.5
    load_s: float = 5.0
    """Timeout for starting a process and importing the class."""

    @property
    def errand_s(self) -> float:
        """Return the timeout for stopping the robot with a new object: connect, wait for a running call, stop,
        disconnect."""
        return self.connect_s + self.call_s + self.stop_s + self.cleanup_s


class PlainConfig(msgspec.Struct, frozen=True):
    """The configuration of a robot with a user's driver class.

    Attributes:
        robot: Name of the robot.
        location: Where the class is defined.
        keywords: Arguments for the class.
        declared: The axes that the class declares.
        has_channel: True if the class can stop its robot without an object, by ``stop_channel(port)``.
        deadlines: Timeouts of the object's methods.
    """

    robot: str
    location: ClassLocation
    keywords: dict[str, Any]
    declared: Declared
    has_channel: bool = False
    deadlines: Deadlines = Deadlines()

    @property
    def name(self) -> str:
        """Return the name of the class."""
        return self.location.name

    @property
    def axes(self) -> tuple[str, ...]:
        """Return the public name of each axis. The key ``x.pos`` of the class is the axis ``x``."""
        return tuple(key.removesuffix(".pos") for key in self.declared.keys)
