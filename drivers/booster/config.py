"""Settings of a T1, shared by the process that drives it (the wire) and the supervising process
(root), which can also stop it."""

from __future__ import annotations

import msgspec

from .protocol import CommandType
from .robots import Model

CONTROL_HZ = 100.0
CONTROL_S = 1 / CONTROL_HZ
"""Period of commands, at the vendor's rate."""

TWIST_S = 0.3
"""How long one ``move`` walks."""


LATE_S = 1.0
"""Longest delay after which a request of a killed participant may still be carried out [assumed: the
vendor's client gives up after 1 s]. The root is another participant, so its requests may overtake that
one."""


class BoosterConfig(msgspec.Struct, frozen=True):
    model: Model
    host: str
    """The robot's address: ``host`` or ``host:port``."""
    interface: str = ""
    """Our own address on its network; empty for the interface that leads there."""
    domain: int = 0
    name: str = ""
    """The robot's own name, which is part of its topics; empty if it has none."""
    command_type: CommandType = CommandType.PARALLEL
