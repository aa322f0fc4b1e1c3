"""Messages between the root and its standby."""

from __future__ import annotations

from strands_actors.kernel.messages import Message


class WatchOver(Message, frozen=True):
    """The processes that the standby must watch.

    Attributes:
        root: Process id of the root.
        wire: Process id of the wire process that was started last; 0 without one.
        descriptors: The shared page of heartbeats, then a pidfd of each process if the system has pidfds.
    """

    lane = "urgent"

    root: int
    wire: int
    descriptors: tuple[int, ...]


class Guard(Message, frozen=True):
    """Descriptors for the standby's stop channel. The reply is sent when the channel is ready to stop the robot."""

    lane = "urgent"

    descriptors: tuple[int, ...]


class Guarding(Message, frozen=True):
    pass


class LetGo(Message, frozen=True):
    """Close the stop channel, because the next wire process must open the port."""

    lane = "urgent"


class LetGone(Message, frozen=True):
    pass
