"""What the wire and the stop channel of a T1 know of it."""

from __future__ import annotations

import msgspec

from .protocol import CommandType
from .robots import Model

CONTROL_HZ = 100.0
CONTROL_S = 1 / CONTROL_HZ
"""The vendor's rate for commands."""

TWIST_S = 0.3
"""How long the robot walks by one ``move``."""


LATE_S = 1.0
"""A request of a participant that was killed may be carried out so late [assumed: the vendor's client
gives up after 1 s]. The root is another participant, and its requests may overtake it."""


class BoosterConfig(msgspec.Struct, frozen=True):
    model: Model
    host: str
    """The robot's address: ``host`` or ``host:port``."""
    interface: str = ""
    """Our own address on its network; empty: the one that leads there."""
    domain: int = 0
    name: str = ""
    """The robot's own, which is part of its topics; empty: it has none."""
    command_type: CommandType = CommandType.PARALLEL
