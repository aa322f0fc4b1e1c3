"""The disk below a dataset: files that are whole or not there."""

from __future__ import annotations

import fcntl
import os
import shutil
from pathlib import Path
from typing import IO

from .errors import DatasetError

STAGED_SUFFIX = ".staged"
REMOVED = "removed-"
"""Before the name of a folder that is being removed."""


class Storage:
    """Every byte of a dataset goes through here."""

    def create(self, path: Path) -> IO[bytes]:
        """Open a new file that grows. Its folder is made."""
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("w+b")

    def sync(self, file: IO[bytes]) -> None:
        """Wait until what was written is on the disk."""
        file.flush()
        os.fsync(file.fileno())

    def place(self, staged: Path, final: Path) -> None:
        """Give a complete file its name, in one step; one that is there is replaced."""
        final.parent.mkdir(parents=True, exist_ok=True)
        os.replace(staged, final)

    def sync_path(self, path: Path) -> None:
        """Wait until a file, or the names in a folder, are on the disk."""
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def write(self, path: Path, data: bytes) -> None:
        """Write a whole file: beside its place first, then under its name."""
        staged = path.with_name(path.name + STAGED_SUFFIX)
        with self.create(staged) as file:
            file.write(data)
            self.sync(file)
        self.place(staged, path)

    def remove(self, path: Path) -> None:
        """Remove a file or a folder, if it is there. A folder loses its name first: half of one
        means nothing."""
        if path.is_dir():
            gone = path.with_name(REMOVED + path.name)
            os.replace(path, gone)
            shutil.rmtree(gone)
        else:
            path.unlink(missing_ok=True)

    def free_bytes(self, path: Path) -> int:
        return shutil.disk_usage(path).free


class Lock:
    """Who writes into a folder; one at a time. It ends with its process."""

    def __init__(self, folder: Path) -> None:
        """Raise ``DatasetError`` when another process writes into it."""
        self._descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._descriptor)
            raise DatasetError(f"{folder}: another process writes into it. end that one first") from None

    def is_of(self, folder: Path) -> bool:
        """Whether this is still the folder of that name: it may have been moved, or its disk taken
        away."""
        try:
            return os.path.samestat(os.stat(folder), os.fstat(self._descriptor))
        except OSError:
            return False

    def release(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
