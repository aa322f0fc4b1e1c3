"""A page of shared memory in which each process of a tree notes its last heartbeat.

Only the newest heartbeat counts. As a message it cost two system calls, a wake-up and a decoding, 250 times a
second each way for legs: 8 % of the computing of their wire process, a fifth of that of their root. Here it is
one store, and one load when the other process looks, which it does at each tick anyway. A process that is
frozen, spins or has ended stores nothing, so its last heartbeat grows old.
"""

from __future__ import annotations

import mmap
import os
import sys
import tempfile

PLACES = 9
_ROOM = 8
"""Words of 8 bytes between two places, so that each has its own cache line. An aligned word is stored as a
whole."""
_BYTES = PLACES * _ROOM * 8


class Word:
    """One number on a page, of 64 bits with a sign. It begins as 0."""

    __slots__ = ("_at", "_words")

    def __init__(self, words: memoryview, place: int) -> None:
        self._words = words
        self._at = place * _ROOM

    def set(self, value: int) -> None:
        self._words[self._at] = value

    def get(self) -> int:
        value: int = self._words[self._at]
        return value


class Heartbeat:
    """One end of a pair of heartbeats. Times are nanoseconds of the host's monotonic clock; 0 means never."""

    __slots__ = ("_other", "_own", "_words")

    def __init__(self, words: memoryview, own: int, other: int) -> None:
        """Use two places on a page."""
        self._words = words
        self._own = own * _ROOM
        self._other = other * _ROOM

    def beat(self, now_ns: int) -> None:
        self._words[self._own] = now_ns

    @property
    def heard_ns(self) -> int:
        """The time of the other end's last heartbeat."""
        heard_ns: int = self._words[self._other]
        return heard_ns

    def forget(self) -> None:
        """Forget the last heartbeat, because the other end is a new process."""
        self._words[self._other] = 0


def new_page() -> int:
    """Make a page and return its descriptor, which is passed to child processes."""
    if sys.platform == "linux":
        fd = os.memfd_create("heartbeat")
    else:
        with tempfile.TemporaryFile() as file:
            fd = os.dup(file.fileno())
    os.ftruncate(fd, _BYTES)
    return fd


def words_of(fd: int) -> memoryview:
    """Map the page of a descriptor, which may be closed afterwards."""
    return memoryview(mmap.mmap(fd, _BYTES)).cast("q")


def private_page() -> memoryview:
    """Return a page of this process alone."""
    return memoryview(bytearray(_BYTES)).cast("q")


def pair() -> tuple[Heartbeat, Heartbeat]:
    """Return both ends in this process."""
    words = private_page()
    return Heartbeat(words, 0, 1), Heartbeat(words, 1, 0)
