"""The directory where the robots of this user meet: sockets, and one note a robot on how to reach it.

``$STRANDS_ACTORS_RUN``, else ``$XDG_RUNTIME_DIR/strands-actors``, else ``/tmp/strands-actors-<uid>``; for
the user alone. A robot's name is its for as long as a process holds its lock.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import msgspec

MAX_SOCKET_PATH = 100
"""Bytes a unix socket's path may have (108 on Linux, less what zenoh appends)."""


class Note(msgspec.Struct):
    """How to reach a robot's tree."""

    robot: str
    kind: str
    pid: int
    endpoints: list[str]  # of its actors
    mesh: list[str] = []  # of its topics: what a subscriber connects to
    unconfirmed: list[str] = []  # motors that its root could not confirm safe so far, and goes on trying


def run_dir() -> Path:
    """The directory, made if need be. Raise ``PermissionError`` when it is not ours alone."""
    named = os.environ.get("STRANDS_ACTORS_RUN")
    base = os.environ.get("XDG_RUNTIME_DIR")
    path = (
        Path(named)
        if named
        else Path(base) / "strands-actors"
        if base
        else Path(tempfile.gettempdir()) / f"strands-actors-{os.getuid()}"
    )
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    status = path.stat()
    if status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise PermissionError(f"{path} is open to others: chmod 700 it, or set STRANDS_ACTORS_RUN to another place")
    return path


class Name:
    """A robot's name, held by a lock that the tree's root inherits."""

    def __init__(self, wanted: str) -> None:
        directory = run_dir()
        for number in range(1, 1000):
            self.name = wanted if number == 1 else f"{wanted}-{number}"
            self.lock_fd = os.open(directory / f"{self.name}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(self.lock_fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(self.lock_fd)
            else:
                return
        raise RuntimeError(f"there are 999 robots called {wanted} already")

    def socket(self, role: str) -> str:
        """Path of a process's socket. Raise ``ValueError`` when it is too long for one."""
        path = str(run_dir() / f"{self.name}.{role}.sock")
        if len(path.encode()) > MAX_SOCKET_PATH:
            raise ValueError(f"{path} is too long for a socket: set STRANDS_ACTORS_RUN to a shorter place")
        return path

    @property
    def note(self) -> Path:
        """Where it is published."""
        return run_dir() / f"{self.name}.json"

    def publish(self, note: Note) -> None:
        target = self.note
        draft = target.with_suffix(".tmp")
        draft.write_bytes(msgspec.json.encode(note))
        draft.replace(target)

    def release(self) -> None:
        """Close our hold; the root's own lives as long as it does."""
        os.close(self.lock_fd)


def notes() -> Iterator[Note]:
    """The robots whose lock somebody holds; notes of others are removed."""
    for path in sorted(run_dir().glob("*.json"), key=lambda path: path.stem):
        lock = path.with_suffix(".lock")
        try:
            fd = os.open(lock, os.O_RDWR | os.O_CLOEXEC)
        except FileNotFoundError:
            continue
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield msgspec.json.decode(path.read_bytes(), type=Note)
        else:
            path.unlink(missing_ok=True)
        finally:
            os.close(fd)
