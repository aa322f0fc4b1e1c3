"""The audit: which sender ordered what, when, and the decision, as one JSON line each in a file that outlives
the tree.

The file has the commands that begin or end something (a lease, a resume, a stop, a task), every refusal from
the mesh, and of the setpoints of a lease the first one and each change between accepted and refused. The root
writes it, and never waits for a disk. Lines that come faster than ``LINES_PER_S``, or that the disk does not
take, are counted, and the count is written.
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
"""The most bytes of a file. Then it is renamed."""
KEPT = 4
"""The number of renamed files that are kept. ``.1`` is the newest."""
LINES_PER_S = 50
BURST = 200
_WAITING = 500
_TEXT = 200
"""The most characters of a received text. So a line has about a kilobyte at most."""
AGAIN_S = 1.0
"""Pause (s) after the disk has refused a line."""


class Line(msgspec.Struct, frozen=True, omit_defaults=True):
    """One line of the audit.

    Attributes:
        time: Wall-clock time, UTC.
        who: The sender, as named by itself.
        what: The order.
        how: The decision.
        over: The way of the order, which is certain: the mesh, a policy process, or the tree's own ways.
        left_out: Lines before this one that are missing.
    """

    time: str
    who: str
    what: str
    how: str
    over: str = ""
    left_out: int = 0


class Audit:
    """The audit of one robot. Without a path nothing is kept.

    Attributes:
        problem: Why the last line could not be written. Empty if it was.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._lines: deque[Line] = deque()
        self._left_out = 0
        self._limit = Limit(LINES_PER_S, BURST)
        self._news = trio.Event()
        self._writing = trio.Lock()  # the end of the tree writes the waiting lines, too
        self.problem = ""

    def note(self, who: str, what: str, how: str, over: str = "") -> None:
        """Add a line. Lines above the limits are counted and dropped."""
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
        """Write the lines until cancelled."""
        while True:
            await self._news.wait()
            await self.settle()
            if self.problem:
                await trio.sleep(AGAIN_S)

    async def settle(self) -> None:
        """Write the waiting lines, unless the disk refuses them."""
        async with self._writing:
            self._news = trio.Event()
            lines = list(self._lines)
            if not lines or self._path is None:
                return
            try:
                await trio.to_thread.run_sync(_write, self._path, lines)
            except (OSError, RuntimeError) as error:  # an error of the disk, or no thread can be started
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
