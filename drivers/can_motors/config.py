"""The immutable settings of an arm of CAN motors, for its wire and its stop channel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from .robots import Arm


class CanConfig(msgspec.Struct, frozen=True):
    """The settings.

    Attributes:
        arm: The arm.
        ports: The name of each bus: a network interface, or the path of an adapter.
        adapters: The format of each bus (``adapters.py``).
        baud: Bits per second of a serial port.
        control_s: Period of the commands.
        model: The arm's table with its links, for lowering and for its weight.
        lower_s: Longest time for lowering the arm.
        gravity: True if the weight of the arm is compensated.
    """

    arm: Arm
    ports: tuple[str, ...]
    adapters: tuple[str, ...]
    baud: int
    control_s: float
    model: Mapping[str, Any]
    lower_s: float
    gravity: bool
