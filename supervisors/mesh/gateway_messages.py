"""What a caller of another host tells a robot's gateway, and is told: msgpack, as between all
actors.

Who commands from afar shares no clock with the robot. It reads the robot's clock first (``Sync``),
and dates every command by that reading (``Dated``): what comes later than it was meant is refused,
however long it was on its way.
"""

from __future__ import annotations

from strands_actors.kernel.messages import Message
from strands_actors.supervisors.gate.messages import Acquire, Beat, Perform, Release, Resume, Setpoint

Datable = Setpoint | Acquire | Beat | Release | Resume | Perform


class Sync(Message, frozen=True):
    """Read the robot's clock. ``session``: of an earlier reading, which goes on; empty: there is
    none yet."""

    session: str = ""
    channel: str = ""  # who asks, by the key on which it does


class Synced(Message, frozen=True):
    """``session``: who may write by a lease of this session is known by it; keep it to yourself.
    ``robot_ns``: the robot's clock, CLOCK_MONOTONIC of its host, when this was sent."""

    session: str
    robot_ns: int
    kind: str
    axes: tuple[str, ...]


class Dated(Message, frozen=True):
    """May not be obeyed later than ``deadline_ns``, a time of the robot's clock. Times within
    ``message`` are of that clock, too."""

    session: str
    deadline_ns: int
    message: Datable
    channel: str = ""  # who asks, by the key on which it does
