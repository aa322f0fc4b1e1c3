"""A page of memory that two processes share, in which each notes when it last beat.

A heartbeat says one thing, and only the newest counts; as a message it cost two system calls, a wake-up and a
decoding, 250 times a second each way for legs: 8 % of what their wire computed, a fifth of what their root did.
Here it is one store, and one load when the other looks, which it does at each tick anyway. A process that is
frozen, spins or is dead stores nothing, and what it stored last grows old by itself.
"""

from __future__ import annotations

import mmap
import os
import sys
import tempfile

_ROOM = 8
"""Words of 8 bytes between the two: a cache line each. An aligned word is stored as a whole."""
_BYTES = 2 * _ROOM * 8


class Heartbeat:
    """One end. Times are nanoseconds of the host's monotonic clock, the same in all its processes; 0: never."""

    __slots__ = ("_other", "_own", "_words")

    def __init__(self, words: memoryview, end: int) -> None:
        """``words``: signed, of 8 bytes; ``end``: 0 or 1."""
        self._words = words
        self._own = end * _ROOM
        self._other = (1 - end) * _ROOM

    def beat(self, now_ns: int) -> None:
        self._words[self._own] = now_ns

    @property
    def heard_ns(self) -> int:
        """When the other end last beat."""
        heard_ns: int = self._words[self._other]
        return heard_ns

    def forget(self) -> None:
        """The other end is another process from now on."""
        self._words[self._other] = 0


def new_page() -> int:
    """A descriptor that child processes are given."""
    if sys.platform == "linux":
        fd = os.memfd_create("heartbeat")
    else:
        with tempfile.TemporaryFile() as file:
            fd = os.dup(file.fileno())
    os.ftruncate(fd, _BYTES)
    return fd


def on_page(fd: int, end: int) -> Heartbeat:
    """An end of the page that a descriptor gives; it may be closed afterwards."""
    return Heartbeat(memoryview(mmap.mmap(fd, _BYTES)).cast("q"), end)


def pair() -> tuple[Heartbeat, Heartbeat]:
    """Both ends in this process."""
    words = memoryview(bytearray(_BYTES)).cast("q")
    return Heartbeat(words, 0), Heartbeat(words, 1)
