"""Where the pictures of this user's cameras lie: in memory, one file a camera.

``/dev/shm/strands-actors-<uid>-<mark>``, where the mark is that of the run directory; without
``/dev/shm``, or where another user has taken that name, the run directory itself. For the user
alone.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

from strands_actors.caller.run_directory import is_held, run_dir

SHARED = Path("/dev/shm")
SUFFIX = ".pictures"


def pictures_dir(make: bool = False) -> Path:
    """``make``: it need not be there yet. Raise ``OSError`` when it is ours but open to others, or
    not there."""
    own = run_dir()
    if not os.access(SHARED, os.W_OK):
        return own
    mark = hashlib.sha256(str(own.resolve()).encode()).hexdigest()[:12]
    path = SHARED / f"strands-actors-{os.getuid()}-{mark}"
    if make:
        path.mkdir(mode=0o700, exist_ok=True)
    status = path.lstat()
    if status.st_uid != os.getuid():
        return own  # anybody may take a name in there: the owner decides, and every process sees the same
    if status.st_mode & 0o077 or not path.is_dir() or path.is_symlink():
        raise PermissionError(f"{path} is open to others, or no directory: remove it")
    return path


def ring_path(robot: str, camera: str, make: bool = False) -> Path:
    """As ``pictures_dir``."""
    return pictures_dir(make) / f"{robot}@{camera}{SUFFIX}"


def cameras_of(robot: str) -> list[str]:
    """Those that have a file."""
    try:
        paths = list(pictures_dir().glob(f"{robot}@*{SUFFIX}"))
    except OSError:
        return []
    return sorted(path.name[len(robot) + 1 : -len(SUFFIX)] for path in paths)


def remove(robot: str) -> None:
    """The files of a robot that has ended; and the directory, when it was the last one."""
    with contextlib.suppress(OSError):
        directory = pictures_dir()
        for camera in cameras_of(robot):
            (directory / f"{robot}@{camera}{SUFFIX}").unlink(missing_ok=True)
        if directory != run_dir():
            directory.rmdir()  # fails while there are others


def sweep() -> None:
    """Remove what robots have left that nobody could end in order."""
    with contextlib.suppress(OSError):
        for name in {path.name.partition("@")[0] for path in pictures_dir().glob(f"*@*{SUFFIX}")}:
            if not is_held(name):
                remove(name)
