"""The facts about a driver class that all processes of its robot share, and the deadlines of its calls."""

from __future__ import annotations

from typing import Any

import msgspec

from .class_location import ClassLocation
from .members import Declared

LATE_S = 0.5
"""Longest time for which a message, sent before the class's process was killed, may still take effect
[assumed: on a local network]."""


class Deadlines(msgspec.Struct, frozen=True):
    """Longest times of the calls of an object, in seconds."""

    connect_s: float = 5.0
    """To make and connect the object: the class may import an SDK there."""
    call_s: float = 0.5
    """Longest time of ``send_action`` and ``get_observation``. A stop waits for the running call, so this
    delays it at most."""
    stop_s: float = 1.0
    cleanup_s: float = 0.5
    load_s: float = 5.0
    """To start a process and import the class."""

    @property
    def errand_s(self) -> float:
        """Return the longest time of a process that was started to stop the robot. It connects first."""
        return self.connect_s + self.call_s + self.stop_s + self.cleanup_s


class PlainConfig(msgspec.Struct, frozen=True):
    """``keywords``: arguments of the class. ``has_channel``: the class can stop its robot without an
    object, by ``stop_channel(port)``."""

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
        """Return the public name of each axis: ``x.pos`` is the axis ``x``."""
        return tuple(key.removesuffix(".pos") for key in self.declared.keys)
