"""What the root and its standby tell each other."""

from __future__ import annotations

from strands_actors.kernel.messages import Message


class WatchOver(Message, frozen=True):
    """The pids of the root and of the wire that was started last; 0: none. ``descriptors``: the
    page of heartbeats, then a pidfd of each, where the system has such."""

    lane = "urgent"

    root: int
    wire: int
    descriptors: tuple[int, ...]


class Guard(Message, frozen=True):
    """Descriptors for the standby's stop channel. Answered when that could be used at once."""

    lane = "urgent"

    descriptors: tuple[int, ...]


class Guarding(Message, frozen=True):
    pass


class LetGo(Message, frozen=True):
    """Close the stop channel: the next wire opens the port."""

    lane = "urgent"


class LetGone(Message, frozen=True):
    pass
