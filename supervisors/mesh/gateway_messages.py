"""Messages between a caller on another host and a robot's gateway, in msgpack as between all actors.

A caller on another host shares no clock with the robot. It first reads the robot's clock (``Sync``)
and gives every command a deadline on that clock (``Dated``). The gateway refuses a command that
arrives after its deadline.
"""

from __future__ import annotations

from strands_actors.kernel.messages import Message
from strands_actors.supervisors.gate.messages import Acquire, Beat, Perform, Release, Resume, Setpoint

Datable = Setpoint | Acquire | Beat | Release | Resume | Perform
"""The messages that may be in a ``Dated``."""


class Sync(Message, frozen=True):
    """Read the robot's clock.

    Attributes:
        session: Name of the caller's session, to renew it; empty to begin a new session.
        channel: Name of the caller; the receiver sets it from the key of the query.
    """

    session: str = ""
    channel: str = ""


class Synced(Message, frozen=True):
    """The answer to ``Sync``.

    Attributes:
        session: Name of the caller's session. It is secret, since it proves the right to use the leases of the
            session.
        robot_ns: The robot's clock (CLOCK_MONOTONIC of its host) when this answer was sent.
        kind: Type of the robot, such as ``so101``.
        axes: The axes of the robot.
    """

    session: str
    robot_ns: int
    kind: str
    axes: tuple[str, ...]


class Dated(Message, frozen=True):
    """A command with a deadline.

    Attributes:
        session: The caller's session.
        deadline_ns: Deadline on the robot's clock. The command is not carried out later.
        message: The command. The times in it are of the robot's clock, too.
        channel: Name of the caller; the receiver sets it from the key of the query.
    """

    session: str
    deadline_ns: int
    message: Datable
    channel: str = ""
