"""A page of shared memory in which each process of a robot notes its last heartbeat.

Only the newest heartbeat counts, so heartbeats are not sent as messages. A message takes two system calls, a
wake-up and a decoding, 250 times a second each way for legs. That was 8 % of the computing time of the wire
process, and a fifth of that of the root process. Here a heartbeat is one store into memory. The other process
loads it at each of its ticks. A process that is frozen, spins or has ended stores nothing, so its last
heartbeat grows old.
"""

from __future__ import annotations

import mmap
import os
import sys
import tempfile
from pathlib import Path

PLACES = 9
_ROOM = 8
"""Words of 8 bytes between two places, so that each has its own cache line. An aligned word is stored as a
whole."""
_BYTES = PLACES * _ROOM * 8


class Word:
    """One number on a page (memory with the heartbeats of processes), of 64 bits with a sign. It begins as 0."""

    __slots__ = ("_index", "_words")

    def __init__(self, words: memoryview, place: int) -> None:
        self._words = words
        self._index = place * _ROOM

    def set(self, value: int) -> None:
        self._words[self._index] = value

    def get(self) -> int:
        value: int = self._words[self._index]
        return value


class Heartbeat:
    """One end of a pair of heartbeats. It stores its own heartbeat, and reads that of the other end.

    Times are nanoseconds of the host's monotonic clock; 0 means never.
    """

    __slots__ = ("_own", "_peer", "_words")

    def __init__(self, words: memoryview, own: int, peer: int) -> None:
        """Use two places on a page of heartbeats: one for the own heartbeat, and one for that of the other end."""
        self._words = words
        self._own = own * _ROOM
        self._peer = peer * _ROOM

    def beat(self, now_ns: int) -> None:
        self._words[self._own] = now_ns

    @property
    def last_received_ns(self) -> int:
        """The time of the other end's last heartbeat."""
        received_ns: int = self._words[self._peer]
        return received_ns

    def forget(self) -> None:
        """Forget the last heartbeat, because the other end is a new process."""
        self._words[self._peer] = 0


def new_page(file: Path | None = None) -> int:
    """Make a page of shared memory for heartbeats. Return its descriptor, which is passed to child processes.

    Args:
        file: A file with the page, for processes that are no children. An existing file is replaced.
    """
    if file is not None:
        file.unlink(missing_ok=True)
        fd = os.open(file, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    elif sys.platform == "linux":
        fd = os.memfd_create("heartbeat")
    else:
        with tempfile.TemporaryFile() as file:
            fd = os.dup(file.fileno())
    os.ftruncate(fd, _BYTES)
    return fd


def words_of(fd: int) -> memoryview:
    """Map the page of heartbeats behind a descriptor, which may be closed afterwards."""
    return memoryview(mmap.mmap(fd, _BYTES)).cast("q")


def private_page() -> memoryview:
    """Return a page for heartbeats that only this process can read and write."""
    return memoryview(bytearray(_BYTES)).cast("q")


def pair() -> tuple[Heartbeat, Heartbeat]:
    """Return the two ends of a pair of heartbeats, both in this process."""
    words = private_page()
    return Heartbeat(words, 0, 1), Heartbeat(words, 1, 0)
