"""The files in shared memory through which this user's cameras pass their pictures, one file for each camera.

The directory is ``/dev/shm/strands-actors-<uid>-<mark>``, where the mark is a hash of the run directory's
path. Without ``/dev/shm``, or if another user has taken that name, the files are in the run directory. Only
this user can open the directory.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

from strands_actors.caller.processes.run_directory import is_running, run_dir

SHARED = Path("/dev/shm")
SUFFIX = ".pictures"


def pictures_dir(make: bool = False) -> Path:
    """Return the directory of the files.

    Args:
        make: Make the directory if it does not exist.

    Raises:
        OSError: The directory does not exist, or other users can open it.
    """
    own = run_dir()
    if not os.access(SHARED, os.W_OK):
        return own
    mark = hashlib.sha256(str(own.resolve()).encode()).hexdigest()[:12]
    path = SHARED / f"strands-actors-{os.getuid()}-{mark}"
    if make:
        path.mkdir(mode=0o700, exist_ok=True)
    status = path.lstat()
    if status.st_uid != os.getuid():
        # Another user has made a directory of this name in /dev/shm. Every process of this user sees the same
        # owner, so all of them use the run directory instead.
        return own
    if status.st_mode & 0o077 or not path.is_dir() or path.is_symlink():
        raise PermissionError(f"{path} is open to others, or no directory: remove it")
    return path


def ring_path(robot: str, camera: str, make: bool = False) -> Path:
    """Return the path of a camera's file. Raises the same as ``pictures_dir``."""
    return pictures_dir(make) / f"{robot}@{camera}{SUFFIX}"


def cameras_of(robot: str) -> list[str]:
    """Return the names of a robot's cameras that have a file."""
    try:
        paths = list(pictures_dir().glob(f"{robot}@*{SUFFIX}"))
    except OSError:
        return []
    return sorted(path.name[len(robot) + 1 : -len(SUFFIX)] for path in paths)


def remove(robot: str) -> None:
    """Remove the files of a robot that has ended, and the directory if it is then empty."""
    with contextlib.suppress(OSError):
        directory = pictures_dir()
        for camera in cameras_of(robot):
            (directory / f"{robot}@{camera}{SUFFIX}").unlink(missing_ok=True)
        if directory != run_dir():
            directory.rmdir()  # This fails while other files exist.


def sweep() -> None:
    """Remove the files of robots that have ended without removing them."""
    with contextlib.suppress(OSError):
        for name in {path.name.partition("@")[0] for path in pictures_dir().glob(f"*@*{SUFFIX}")}:
            if not is_running(name):
                remove(name)
