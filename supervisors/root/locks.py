"""The lock of an e-stop, as a file: it outlives the tree it was put on, the script, and a reboot.

One file for each robot and port in one directory of this user. A robot is locked by a file of its
name, whatever the port, and by one of its port, whatever the name. Both stand in the file's own
name, so that it is known for whom a file counts even when its content cannot be read. Such a file
locks, too.
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
    """What a file says, for people."""

    robot: str
    port: str
    by: str


class Lock(NamedTuple):
    """``since``: ISO 8601, UTC, as the file system has it; empty when it is not known."""

    by: str
    since: str


def place_of_port(port: str) -> str:
    """Return what a port leads to: of a path the device, of an address the address as it was given,
    whatever the working directory is."""
    return os.path.realpath(port) if os.path.isabs(port) or os.path.exists(port) else port


class Locks:
    """Of one robot. ``port``: empty for a twin or a simulation, which is known by its name
    alone."""

    def __init__(self, directory: Path, robot: str, port: str = "") -> None:
        self._directory = directory
        self._robot = robot
        self._port = port
        self._mark = hashlib.sha256(place_of_port(port).encode()).hexdigest()[:16] if port else ""

    def find(self) -> Lock | None:
        """Return the newest lock that binds this robot. Raise nothing: what cannot be read
        locks."""
        try:
            paths = self._files()
        except OSError as error:
            return Lock(f"{UNREADABLE} ({error})", "")
        locks = sorted((_read(path) for path in paths), key=lambda lock: lock.since)
        return locks[-1] if locks else None

    def put(self, by: str) -> str:
        """Lock it; since when. It is on the disk when this returns. Raise ``OSError``."""
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
        """Remove every lock that binds this robot. Raise ``OSError``."""
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
    """Return every name that stands on a lock. Raise ``OSError``."""
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
