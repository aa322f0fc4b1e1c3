"""Store the lock of an e-stop as a file, so that the robot is still locked after its processes, the script or the
computer were restarted.

There is one file for each robot and port, in one directory of the user. A file locks every robot with this name, at
any port, and every robot at this port, with any name. The file's name contains both, so it is known which robot a
file locks even if its content cannot be read. Such a file locks the robot, too.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import msgspec

UNREADABLE = "an e-stop whose lock cannot be read"


class Note(msgspec.Struct):
    """The content of a lock file. It is only for people."""

    robot: str
    port: str
    by: str


class Lock(NamedTuple):
    """A lock. ``by`` is its operator. ``since`` is the time of its file, ISO 8601 in UTC; empty if it is not
    known."""

    by: str
    since: str


def place_of_port(port: str) -> str:
    """Return a port in a form that is always the same for one robot: the device behind a path, or an address
    unchanged."""
    return os.path.realpath(port) if os.path.isabs(port) or os.path.exists(port) else port


class Locks:
    """The lock files of one robot. ``port`` is empty for a simulated robot, which is known by its name only."""

    def __init__(self, directory: Path, robot: str, port: str = "") -> None:
        self._directory = directory
        self._robot = robot
        self._port = port
        self._mark = hashlib.sha256(place_of_port(port).encode()).hexdigest()[:16] if port else ""

    def find(self) -> Lock | None:
        """Return the newest lock of this robot; None if it is not locked. Never raises: a file that cannot be read
        is a lock."""
        try:
            paths = self._files()
        except OSError as error:
            return Lock(f"{UNREADABLE} ({error})", "")
        locks = sorted((_read(path) for path in paths), key=lambda lock: lock.since)
        return locks[-1] if locks else None

    def put(self, by: str) -> str:
        """Lock the robot and return the time. The file is on the disk when this returns. Raise ``OSError`` if that
        fails."""
        self._directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        path = self._directory / f"{self._robot}{'@' if self._mark else ''}{self._mark}.json"
        draft = path.with_suffix(f".{os.getpid()}.tmp")
        try:
            with draft.open("wb") as file:
                file.write(msgspec.json.encode(Note(self._robot, self._port, by)))
                file.flush()
                os.fsync(file.fileno())
            draft.replace(path)
        except OSError:
            with contextlib.suppress(OSError):
                draft.unlink(missing_ok=True)
            raise
        _sync(self._directory)
        return _since(path)

    def lift(self) -> None:
        """Remove every lock of this robot. Raise ``OSError`` if a file cannot be removed."""
        paths = self._files()
        for path in paths:
            path.unlink(missing_ok=True)
        if paths:
            _sync(self._directory)

    def _files(self) -> list[Path]:
        try:
            names = os.listdir(self._directory)
        except FileNotFoundError:
            return []
        return [self._directory / name for name in names if self._binds(name)]

    def _binds(self, name: str) -> bool:
        stem, suffix = os.path.splitext(name)
        robot, _, mark = stem.partition("@")
        return suffix == ".json" and (robot == self._robot or (mark != "" and mark == self._mark))


def locked_robots(directory: Path) -> list[str]:
    """Return the names of all locked robots. Raise ``OSError`` if the directory cannot be read."""
    with contextlib.suppress(FileNotFoundError):
        names = (os.path.splitext(name) for name in os.listdir(directory))
        return sorted({stem.partition("@")[0] for stem, suffix in names if suffix == ".json"})
    return []


def _read(path: Path) -> Lock:
    try:
        return Lock(msgspec.json.decode(path.read_bytes(), type=Note).by or "an operator", _since(path))
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return Lock(f"{UNREADABLE} ({path}: {error})", _since(path))


def _since(path: Path) -> str:
    try:
        changed_s = path.stat().st_mtime
    except OSError:
        return ""
    return datetime.fromtimestamp(changed_s, UTC).isoformat(timespec="seconds")


def _sync(directory: Path) -> None:
    fd = os.open(directory, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
