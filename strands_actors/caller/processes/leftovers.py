"""Remove the files that ended programs and robots left in the run directory.

A killed process does not remove its sockets, their locks and the robot's files. The next process that reads the
directory removes them.

Each file is removed under the lock of its owner. A shared lock is enough, since no process can get the
exclusive lock meanwhile. A process that waits for the exclusive lock checks afterwards that the path still
leads to the file that it has locked (``LockFile.matches``).
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from strands_actors.supervisors.standby.report import LOCK

SOCKET_LOCK = ".sock.lock"
"""Suffix of zenoh's lock file of a socket. zenoh holds it exclusively while it listens."""
NAME_LOCK = ".lock"
PORT_LOCK = ".port"
PAGE = ".page"
"""Suffix of the file with the shared page of a part (``parts``). Its processes note there what may be energised."""
CALLER = "caller-"


def remove_leftovers(directory: Path) -> None:
    """Remove the files that no process uses. Raise ``OSError`` if the directory cannot be read."""
    names = sorted(path.name for path in directory.iterdir())
    for name in names:
        if name.startswith(CALLER) and name.endswith(SOCKET_LOCK):
            _remove_socket(directory / name)
        elif name.endswith(PORT_LOCK):
            with _unused(directory / name) as is_free:
                if is_free:
                    _unlink(directory / name)
        elif name.endswith(NAME_LOCK) and not name.endswith(SOCKET_LOCK):
            _remove_robot(directory, name.removesuffix(NAME_LOCK), names)


def _remove_robot(directory: Path, robot: str, names: list[str]) -> None:
    with _unused(directory / f"{robot}{NAME_LOCK}") as is_free:
        if not is_free:
            return
        _unlink(directory / f"{robot}.json")
        _unlink(directory / f"{robot}{PAGE}")
        for name in names:
            # The robot "so101" owns "so101.wire.sock". The file "so101.left.wire.sock" belongs to another
            # robot.
            is_its_socket = name.endswith(SOCKET_LOCK) and name.count(".") == robot.count(".") + 3
            if is_its_socket and name.startswith(f"{robot}."):
                _remove_socket(directory / name)
        life = directory / f"{robot}{LOCK}"
        with _unused(life) as is_over:
            if is_over:
                _unlink(life)
        _unlink(directory / f"{robot}{NAME_LOCK}")


def _remove_socket(lock: Path) -> None:
    with _unused(lock) as is_free:
        if is_free:
            _unlink(lock.with_suffix(""))
            _unlink(lock)


@contextlib.contextmanager
def _unused(path: Path) -> Iterator[bool]:
    """Hold the shared lock of a file for a ``with`` block, if no process has the exclusive lock.

    Yields:
        True if the lock is held. False also if the file does not exist or cannot be opened.
    """
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        yield False
        return
    try:
        try:
            fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True
    finally:
        os.close(fd)


def _unlink(path: Path) -> None:
    # Another process may have removed the file already, or the file belongs to another user.
    with contextlib.suppress(OSError):
        path.unlink()
