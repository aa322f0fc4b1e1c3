"""Who told the robot what, when, and how that was decided: one line of JSON each, in a file that
outlives the tree.

A command is written down once: those that begin or end something (a lease, a resume, a stop, a
task), every refusal from the mesh, and of the setpoints of a lease the first, and each change
between accepted and refused. It belongs to the root, which never waits for a disk: lines that come
faster than ``LINES_PER_S``, or that the disk does not take, are counted, and the count is written.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import deque
from pathlib import Path

import msgspec
import trio

from strands_actors.kernel.clock import NS
from strands_actors.kernel.health.realtime import run_like_others
from strands_actors.supervisors.mesh.command_rules import Limit

MAX_BYTES = 1 << 20
"""Of one file; then it is put aside."""
KEPT = 4
"""Files that were put aside: ``.1`` is the newest."""
LINES_PER_S = 50
BURST = 200
_WAITING = 500
_TEXT = 200
"""Characters of what others say: no line is longer than a kilobyte or so."""
AGAIN_S = 1.0
"""After a disk has refused a line."""


class Line(msgspec.Struct, frozen=True, omit_defaults=True):
    """``time``: of the wall's clock, for who reads it. ``who`` is what they say of themselves;
    ``over`` is known: the mesh, a policy process, or the tree's own ways. ``left_out``: lines
    before this one that are not here."""

    time: str
    who: str
    what: str
    how: str
    over: str = ""
    left_out: int = 0


class Audit:
    """``problem``: why the last line could not be written; empty: it was. Without a path nothing is
    kept."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._lines: deque[Line] = deque()
        self._left_out = 0
        self._limit = Limit(LINES_PER_S, BURST)
        self._news = trio.Event()
        self._writing = trio.Lock()  # the end of the tree writes what waits, too
        self.problem = ""

    def note(self, who: str, what: str, how: str, over: str = "") -> None:
        """Any number of times: what is too much is counted."""
        if self._path is None:
            return
        if not self._limit.admits(time.monotonic_ns()) or len(self._lines) >= _WAITING:
            self._left_out += 1
            return
        seconds, nanoseconds = divmod(time.time_ns(), NS)
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds)) + f".{nanoseconds // 1_000_000:03d}Z"
        self._lines.append(Line(stamp, who[:_TEXT], what[:_TEXT], how[:_TEXT], over, self._left_out))
        self._left_out = 0
        self._news.set()

    async def run(self) -> None:
        """For ever."""
        while True:
            await self._news.wait()
            await self.settle()
            if self.problem:
                await trio.sleep(AGAIN_S)

    async def settle(self) -> None:
        """Write what waits, unless the disk does not take it."""
        async with self._writing:
            self._news = trio.Event()
            lines = list(self._lines)
            if not lines or self._path is None:
                return
            try:
                await trio.to_thread.run_sync(_write, self._path, lines)
            except (OSError, RuntimeError) as error:  # the disk, or no thread can be started
                self.problem = str(error)
                self._news.set()
                return
            self.problem = ""
            for _ in lines:
                self._lines.popleft()


def _write(path: Path, lines: list[Line]) -> None:
    run_like_others()
    data = b"".join(_encode(line) + b"\n" for line in lines)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with contextlib.suppress(FileNotFoundError):
        if path.stat().st_size + len(data) > MAX_BYTES:
            _put_aside(path)
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
    fd = os.open(path, flags, 0o600)
    try:
        os.write(fd, data)
    finally:
        os.close(fd)


def _put_aside(path: Path) -> None:
    for number in range(KEPT, 0, -1):
        newer = path if number == 1 else _named(path, number - 1)
        with contextlib.suppress(FileNotFoundError):
            newer.replace(_named(path, number))


def _named(path: Path, number: int) -> Path:
    return path.with_name(f"{path.name}.{number}")


_encode = msgspec.json.encode
