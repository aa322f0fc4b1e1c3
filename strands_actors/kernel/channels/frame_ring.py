"""Pictures between processes: a file in memory that one process writes and any number of processes read.

Theory. A picture is larger than a message between actors, and only the newest one counts. So there is no queue
and no lock. The writer fills a few slots in turn, and a reader copies the newest one. Each slot has a number
that is odd while the slot is written (a seqlock). If the number has changed during the copy, the reader tries
again.

* No process ever waits for another.
* A writer that freezes or is killed in the middle of a picture leaves the previous picture whole.

The file also has a page on the source of the pictures: when it was last alive, its description of itself, and
until when a reader wants compressed pictures.
"""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import threading
from collections.abc import Iterator
from typing import NamedTuple

MAGIC = 0x53415246_00000001  # "SARF", and the version of this layout
PAGE = 4096
HEAD = 64
"""Bytes of the header of each slot."""
SLOTS = 4
COMPRESSED_SLOTS = 3
COMPRESSED_ROOM = 1 << 20
"""The greatest size of a compressed picture in bytes."""
TRIES = 8
"""The greatest number of attempts in one read. If the picture was overwritten in each attempt, the reader gets
nothing.
"""

_MAGIC, _ROOM, _NEWEST, _BEAT, _DESCRIPTION, _DESCRIPTION_BYTES, _REQUESTED_UNTIL, _STALE, _NEWEST_COMPRESSED = (
    range(9)
)
_DESCRIPTION_OFFSET = 512
FRONT = PAGE + COMPRESSED_SLOTS * (HEAD + COMPRESSED_ROOM)
"""The offset of the uncompressed pictures."""


class NoRing(Exception):
    """The file does not exist, or it is not a file of pictures of this package. The text gives the cause."""


class Shot(NamedTuple):
    """A copy of one picture.

    ``number`` counts the pictures in the file. The count continues after a restart of the writer.
    """

    number: int
    # Time of the capture in nanoseconds, on the host's monotonic clock.
    captured_ns: int
    height: int
    width: int
    data: bytes | bytearray


class _Slots:
    """A few slots in a row, with one picture each.

    Args:
        memory: The mapped file.
        words: The same memory, as words of 64 bits.
        offset: The offset of the first slot.
        count: The number of slots.
        room: The greatest size of a picture in bytes.
        newest: The index of the word that has the number of the newest picture.
    """

    def __init__(
        self, memory: memoryview, words: memoryview, offset: int, count: int, room: int, newest: int
    ) -> None:
        self._memory = memory
        self._words = words
        self._offset = offset
        self._count = count
        self._step = HEAD + room
        self._newest = newest
        self.room = room

    @property
    def newest(self) -> int:
        number: int = self._words[self._newest]
        return number

    def place(self, number: int) -> int:
        return self._offset + (number % self._count) * self._step

    def write(self, number: int, captured_ns: int, height: int, width: int, data: memoryview) -> None:
        start = self.place(number)
        head = self._memory[start : start + HEAD].cast("q")
        head[0] = 2 * number - 1
        _in_order()
        self._memory[start + HEAD : start + HEAD + len(data)] = data
        head[1], head[2], head[3], head[4] = captured_ns, height, width, len(data)
        _in_order()
        head[0] = 2 * number
        _in_order()
        self._words[self._newest] = number

    def captured_ns(self) -> int:
        """Return the time at which the newest picture was captured (ns of the monotonic clock); 0 if there is no
        picture or it is being replaced.
        """
        number = self.newest
        if number <= 0:
            # No memory has been allocated for this slot yet. If shared memory is full, even reading the slot would
            # end this process with SIGBUS.
            return 0
        start = self.place(number)
        head = self._memory[start : start + HEAD].cast("q")
        captured_ns: int = head[1]
        _in_order()
        return captured_ns if head[0] == 2 * number else 0

    def read(self) -> Shot | None:
        """Return a copy of the newest picture.

        Return None if there is no picture yet, or if the writer overwrote the picture during each attempt to
        copy it.
        """
        for _ in range(TRIES):
            number = self.newest
            if number <= 0:
                return None
            _in_order()
            start = self.place(number)
            head = self._memory[start : start + HEAD].cast("q")
            _, captured_ns, height, width, size = head[:5]
            if head[0] == 2 * number and 0 <= size <= self.room:
                data = bytearray(self._memory[start + HEAD : start + HEAD + size])
                _in_order()
                if head[0] == 2 * number:
                    return Shot(number, captured_ns, height, width, data)
        return None


class FrameRing:
    """A mapped file of pictures. A process that has the file open can read it even after the file was removed."""

    def __init__(self, path: str, writes: bool = False, front: bool = False) -> None:
        """Open the file.

        Args:
            path: The file, as made by ``create``.
            writes: Open for writing. The process that puts pictures needs it, and each one that requests
                compressed pictures.
            front: Map only the part without the uncompressed pictures. A process that locks its memory needs
                it.

        Raises:
            NoRing: The file does not exist, or is no file of pictures of this user and version.
        """
        self.path = path
        try:
            fd = os.open(path, (os.O_RDWR if writes else os.O_RDONLY) | os.O_CLOEXEC | os.O_NOFOLLOW)
        except OSError as error:
            raise NoRing(f"{path}: {error.strerror}") from None
        try:
            status = os.fstat(fd)
            self.identity = status.st_dev, status.st_ino
            if status.st_uid != os.getuid() or status.st_size < PAGE:
                raise NoRing(f"{path} is no ring of pictures of this user")
            access = mmap.ACCESS_WRITE if writes else mmap.ACCESS_READ
            self._map = mmap.mmap(fd, min(FRONT, status.st_size) if front else status.st_size, access=access)
        except BaseException:
            os.close(fd)
            raise
        self._fd = fd
        self._memory = memoryview(self._map)
        self._words = self._memory[:_DESCRIPTION_OFFSET].cast("q")
        room = self._words[_ROOM]
        if self._words[_MAGIC] != MAGIC or status.st_size != _size(room):
            self.close()
            raise NoRing(f"{path} is no ring of pictures of this version")
        self._compressed = _Slots(
            self._memory, self._words, PAGE, COMPRESSED_SLOTS, COMPRESSED_ROOM, _NEWEST_COMPRESSED
        )
        self._pictures = _Slots(self._memory, self._words, FRONT, SLOTS, room, _NEWEST)
        self._reserved = 0

    def close(self) -> None:
        self._words.release()
        self._memory.release()
        self._map.close()
        os.close(self._fd)

    @property
    def mapped_bytes(self) -> int:
        return len(self._memory)

    @property
    def is_current(self) -> bool:
        """Return True if the path still leads to the file that is open here."""
        try:
            status = os.stat(self.path)
        except OSError:
            return False
        return (status.st_dev, status.st_ino) == self.identity

    # -- the source

    def put(self, captured_ns: int, height: int, width: int, data: memoryview) -> int:
        """Make this picture the newest and return its number.

        Args:
            captured_ns: Time of the capture in nanoseconds, on the host's monotonic clock.
            height: Rows.
            width: Pixels of a row.
            data: The pixels.

        Raises:
            ValueError: The picture is too large for the file.
            OSError: There is no memory for it.
        """
        if len(data) > self._pictures.room:
            raise ValueError(
                f"a picture of {width} x {height} is {len(data)} bytes, but the room for a picture is "
                f"{self._pictures.room} bytes. Give width and height of the camera"
            )
        if len(data) > self._reserved:
            self._reserve(len(data))
        number = self._pictures.newest + 1
        self._pictures.write(number, captured_ns, height, width, data)
        return number

    def put_compressed(self, shot: Shot) -> bool:
        """Store the compressed form of a picture. Return False if it is too large."""
        if len(shot.data) > COMPRESSED_ROOM:
            return False
        offset = self._compressed.place(shot.number)
        with _room_in(self.path):
            os.posix_fallocate(self._fd, offset, HEAD + len(shot.data))
        self._compressed.write(shot.number, shot.captured_ns, shot.height, shot.width, memoryview(shot.data))
        return True

    def beat(self, now_ns: int) -> None:
        self._words[_BEAT] = now_ns

    def write_description(self, description: bytes) -> None:
        """Write the description of the picture source. A text that is too long is cut."""
        description = description[: PAGE - _DESCRIPTION_OFFSET]
        version: int = self._words[_DESCRIPTION] | 1
        self._words[_DESCRIPTION] = version
        _in_order()
        self._memory[_DESCRIPTION_OFFSET : _DESCRIPTION_OFFSET + len(description)] = description
        self._words[_DESCRIPTION_BYTES] = len(description)
        _in_order()
        self._words[_DESCRIPTION] = version + 1

    def _reserve(self, size: int) -> None:
        """Allocate the memory of every slot before it is written. A lack of memory is then an error and does
        not end the process."""
        with _room_in(self.path):
            for number in range(SLOTS):
                os.posix_fallocate(self._fd, self._pictures.place(number), HEAD + size)
        self._reserved = size

    # -- readers

    @property
    def newest(self) -> int:
        """Return the number of the newest picture, or 0 before the first one."""
        return self._pictures.newest

    @property
    def captured_ns(self) -> int:
        """Return the time at which the newest picture was captured (ns of the monotonic clock); 0 if there is no
        picture or it is being replaced.
        """
        return self._pictures.captured_ns()

    def read(self) -> Shot | None:
        return self._pictures.read()

    def read_compressed(self) -> Shot | None:
        return self._compressed.read()

    @property
    def newest_compressed(self) -> int:
        return self._compressed.newest

    @property
    def beaten_ns(self) -> int:
        """Return the time at which the source last reported that it is alive (ns of the monotonic clock); 0 for
        never.
        """
        beaten_ns: int = self._words[_BEAT]
        return beaten_ns

    @property
    def stale_ns(self) -> int:
        """Return the age in nanoseconds from which on a picture of this source is too old to use."""
        stale_ns: int = self._words[_STALE]
        return stale_ns

    @property
    def description(self) -> bytes:
        """Return the last description that the source of the pictures has written of itself, as bytes."""
        for _ in range(TRIES):
            version = self._words[_DESCRIPTION]
            _in_order()
            size = self._words[_DESCRIPTION_BYTES]
            if version % 2 == 0 and 0 <= size <= PAGE - _DESCRIPTION_OFFSET:
                text = bytes(self._memory[_DESCRIPTION_OFFSET : _DESCRIPTION_OFFSET + size])
                _in_order()
                if self._words[_DESCRIPTION] == version:
                    return text
        return b""

    # -- requests for compressed pictures

    def request_compressed(self, until_ns: int) -> None:
        self._words[_REQUESTED_UNTIL] = until_ns

    @property
    def requested_until_ns(self) -> int:
        requested_ns: int = self._words[_REQUESTED_UNTIL]
        return requested_ns


def create(path: str, room: int, stale_ns: int) -> None:
    """Make a file for pictures, in place of an existing one. The file takes memory only for bytes that are
    written.

    Args:
        path: The file.
        room: The greatest size of a picture in bytes.
        stale_ns: The age in nanoseconds from which on a picture is too old to use.

    Raises:
        OSError: The file cannot be made.
    """
    room = -(-room // HEAD) * HEAD
    draft = f"{path}.{os.getpid()}.new"
    with _room_in(path):
        fd = os.open(draft, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            os.ftruncate(fd, _size(room))
            head = memoryview(bytearray(PAGE))
            words = head.cast("q")
            words[_MAGIC], words[_ROOM], words[_STALE] = MAGIC, room, stale_ns
            os.pwrite(fd, head, 0)
            os.replace(draft, path)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(draft)
            raise
        finally:
            os.close(fd)


@contextlib.contextmanager
def _room_in(path: str) -> Iterator[None]:
    """Explain an ``OSError`` of a full disk or of full shared memory."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise OSError(
            f"there is no room for the camera's pictures in {os.path.dirname(path)} ({error.strerror}). "
            "Free some space there"
        ) from None


def _size(room: int) -> int:
    return FRONT + SLOTS * (HEAD + room)


_fence = threading.Lock()


def _in_order() -> None:
    """Let other processors see the earlier stores of this thread before its later ones.

    x86 guarantees this order anyway. On ARM a lock that is released and taken again is a barrier in both
    directions.
    """
    with _fence:
        pass
    with _fence:
        pass
