"""Pictures between processes: a file in memory that one process writes and any number read.

A picture is larger than what actors tell each other, and only the newest counts. So there is no
queue and no lock: the writer goes round a few slots, and who reads looks at the newest one. Each
slot has a number that is odd while it is written (a seqlock): what was overwritten while it was
copied is noticed, and copied anew. Nobody ever waits for anybody, and a writer that is frozen or
killed in the middle of a picture leaves the one before it whole.

Beside the pictures the file has a page with what is known of their source: when it was last alive,
what it says of itself, and until when somebody wants its pictures compressed.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import threading
from typing import NamedTuple

MAGIC = 0x53415246_00000001  # "SARF", and the version of this layout
PAGE = 4096
HEAD = 64
"""Bytes before each slot's content."""
SLOTS = 4
COMPRESSED_SLOTS = 3
COMPRESSED_ROOM = 1 << 20
"""Bytes of a compressed picture, at most."""
TRIES = 8
"""Of one reader: a writer that laps it so often leaves it nothing to read."""

_MAGIC, _ROOM, _NEWEST, _BEAT, _TOLD, _TOLD_BYTES, _WANTED, _STALE, _NEWEST_COMPRESSED = range(9)
_TOLD_AT = 512
FRONT = PAGE + COMPRESSED_SLOTS * (HEAD + COMPRESSED_ROOM)
"""Where the pictures themselves begin."""


class NoRing(Exception):
    """There is no such file, or it is none of ours; the text says which."""


class Shot(NamedTuple):
    """A picture, copied. ``number`` counts those of one file, through restarts of who writes it."""

    number: int
    captured_ns: int  # on the host's monotonic clock
    height: int
    width: int
    data: bytes | bytearray


class _Slots:
    """A few slots in a row, from ``at`` on. ``newest``: the word that has the number of the newest."""

    def __init__(self, memory: memoryview, words: memoryview, at: int, count: int, room: int, newest: int) -> None:
        self._memory = memory
        self._words = words
        self._at = at
        self._count = count
        self._step = HEAD + room
        self._newest = newest
        self.room = room

    @property
    def newest(self) -> int:
        number: int = self._words[self._newest]
        return number

    def place(self, number: int) -> int:
        return self._at + (number % self._count) * self._step

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
        """When the newest one was captured; 0: there is none, or it is being replaced."""
        number = self.newest
        start = self.place(number)
        head = self._memory[start : start + HEAD].cast("q")
        captured_ns: int = head[1]
        _in_order()
        return captured_ns if number > 0 and head[0] == 2 * number else 0

    def read(self) -> Shot | None:
        """Return the newest one. None: there is none yet, or the writer was quicker every time."""
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
    """One file, mapped. Whoever has it open may go on reading after it was removed."""

    def __init__(self, path: str, writes: bool = False, front: bool = False) -> None:
        """Raise ``NoRing``. ``writes``: for the one process that puts pictures, and for the one
        that wants them compressed. ``front``: everything but the pictures themselves, for a process
        that locks what it maps in memory."""
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
        self._words = self._memory[:_TOLD_AT].cast("q")
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
        """Return whether the file at its path is still this one."""
        try:
            status = os.stat(self.path)
        except OSError:
            return False
        return (status.st_dev, status.st_ino) == self.identity

    # -- the source's end

    def put(self, captured_ns: int, height: int, width: int, data: memoryview) -> int:
        """Make this picture the newest; its number. Raise ``ValueError`` for one that is too large,
        ``OSError`` when there is no memory for it."""
        if len(data) > self._pictures.room:
            raise ValueError(
                f"a picture of {width} x {height} is {len(data)} bytes, more than the {self._pictures.room} "
                "that were set aside. give width and height"
            )
        if len(data) > self._reserved:
            self._reserve(len(data))
        number = self._pictures.newest + 1
        self._pictures.write(number, captured_ns, height, width, data)
        return number

    def put_compressed(self, shot: Shot) -> bool:
        """Keep the compressed form of a picture. Whether there is room for it."""
        if len(shot.data) > COMPRESSED_ROOM:
            return False
        at = self._compressed.place(shot.number)
        os.posix_fallocate(self._fd, at, HEAD + len(shot.data))
        self._compressed.write(shot.number, shot.captured_ns, shot.height, shot.width, memoryview(shot.data))
        return True

    def beat(self, now_ns: int) -> None:
        self._words[_BEAT] = now_ns

    def tell(self, what: bytes) -> None:
        """Replace what the source says of itself. At most a page; more is cut."""
        what = what[: PAGE - _TOLD_AT]
        version: int = self._words[_TOLD] | 1
        self._words[_TOLD] = version
        _in_order()
        self._memory[_TOLD_AT : _TOLD_AT + len(what)] = what
        self._words[_TOLD_BYTES] = len(what)
        _in_order()
        self._words[_TOLD] = version + 1

    def _reserve(self, size: int) -> None:
        """Have the memory of every slot before it is written: what is missing then is an error, and
        not the end of the process."""
        for number in range(SLOTS):
            os.posix_fallocate(self._fd, self._pictures.place(number), HEAD + size)
        self._reserved = size

    # -- who reads

    @property
    def newest(self) -> int:
        """Return the number of the newest picture; 0: there was none yet."""
        return self._pictures.newest

    @property
    def captured_ns(self) -> int:
        """When the newest picture was captured; 0: there is none, or it is being replaced."""
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
        """When the source was last alive; 0: never."""
        beaten_ns: int = self._words[_BEAT]
        return beaten_ns

    @property
    def stale_ns(self) -> int:
        """From which age on a picture of this source is stale."""
        stale_ns: int = self._words[_STALE]
        return stale_ns

    @property
    def told(self) -> bytes:
        """Return what the source last said of itself."""
        for _ in range(TRIES):
            version = self._words[_TOLD]
            _in_order()
            size = self._words[_TOLD_BYTES]
            if version % 2 == 0 and 0 <= size <= PAGE - _TOLD_AT:
                what = bytes(self._memory[_TOLD_AT : _TOLD_AT + size])
                _in_order()
                if self._words[_TOLD] == version:
                    return what
        return b""

    # -- who wants compressed pictures

    def want(self, until_ns: int) -> None:
        self._words[_WANTED] = until_ns

    @property
    def wanted_until_ns(self) -> int:
        wanted_ns: int = self._words[_WANTED]
        return wanted_ns


def create(path: str, room: int, stale_ns: int) -> None:
    """Make a file for pictures of at most ``room`` bytes, in place of what is there. Memory is taken
    for what is written only. Raise ``OSError``."""
    room = -(-room // HEAD) * HEAD
    draft = f"{path}.{os.getpid()}.new"
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


def _size(room: int) -> int:
    return FRONT + SLOTS * (HEAD + room)


_fence = threading.Lock()


def _in_order() -> None:
    """Have other processors see what was stored before this no later than what is stored after it.
    On x86 they do anyway. On ARM a lock that is released and taken again is a barrier both ways."""
    with _fence:
        pass
    with _fence:
        pass
