"""The audit: a file with one JSON line for each order, with its sender, its time and the decision. The file remains
when the robot's processes end.

The audit contains the commands that begin or end something (a lease, a resume, a stop, a task) and every refusal of
a command from the mesh. Of the setpoints under a lease, it contains the first one, and each change between accepted
and refused. The root writes the audit and never waits for a disk. If lines come faster than ``LINES_PER_S``, or the
disk refuses them, they are dropped, and the next line has their number.
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
"""Largest size of the file, in bytes. A larger file is renamed, and a new one is begun."""
KEPT = 4
"""The number of renamed files that are kept. ``.1`` is the newest."""
LINES_PER_S = 50
BURST = 200
_WAITING = 500
_TEXT = 200
"""Largest number of characters of a received text. So a line has at most about a kilobyte."""
AGAIN_S = 1.0
"""Pause (s) after the disk has refused a line."""


class Line(msgspec.Struct, frozen=True, omit_defaults=True):
    """One line of the audit.

    Attributes:
        time: Wall-clock time, UTC.
        sender: Name of the sender, as the sender gave it. It may be false.
        order: The order.
        result: The decision.
        over: The route by which the order came: the mesh, a policy process, or one of the robot's own processes.
            The sender cannot falsify it.
        dropped: Number of lines that were dropped before this line.
    """

    time: str
    sender: str = msgspec.field(name="who")
    order: str = msgspec.field(name="what")
    result: str = msgspec.field(name="how")
    over: str = ""
    dropped: int = msgspec.field(name="left_out", default=0)


class Audit:
    """The audit of one robot. Without a path, no line is written.

    Attributes:
        problem: Why the last line could not be written; empty if it was written.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._lines: deque[Line] = deque()
        self._dropped = 0
        self._limit = Limit(LINES_PER_S, BURST)
        self._news = trio.Event()
        self._writing = trio.Lock()  # ``settle`` is also called when the robot's processes end.
        self.problem = ""

    def note(self, sender: str, order: str, result: str, over: str = "") -> None:
        """Add a line. If lines come too fast, or too many wait, the line is dropped and counted."""
        if self._path is None:
            return
        if not self._limit.admits(time.monotonic_ns()) or len(self._lines) >= _WAITING:
            self._dropped += 1
            return
        seconds, nanoseconds = divmod(time.time_ns(), NS)
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds)) + f".{nanoseconds // 1_000_000:03d}Z"
        self._lines.append(Line(stamp, sender[:_TEXT], order[:_TEXT], result[:_TEXT], over, self._dropped))
        self._dropped = 0
        self._news.set()

    async def run(self) -> None:
        """Write the lines until cancelled."""
        while True:
            await self._news.wait()
            await self.settle()
            if self.problem:
                await trio.sleep(AGAIN_S)

    async def settle(self) -> None:
        """Write all lines that wait. If the disk refuses them, they continue to wait."""
        async with self._writing:
            self._news = trio.Event()
            lines = list(self._lines)
            if not lines or self._path is None:
                return
            try:
                await trio.to_thread.run_sync(_write, self._path, lines)
            except (OSError, RuntimeError) as error:  # error of the disk, or no thread could be started
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
