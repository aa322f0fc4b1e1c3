"""Write the files of a dataset. After a crash, each file is either complete or missing."""

from __future__ import annotations

import fcntl
import os
import shutil
from pathlib import Path
from typing import IO

from .errors import DatasetError

STAGED_SUFFIX = ".staged"
REMOVED = "removed-"
"""Prefix of the name of a folder that is being removed."""


class Storage:
    """Carries out all writes to the disk. Tests replace this class."""

    def create(self, path: Path) -> IO[bytes]:
        """Open a new file for writing, and create its folder."""
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("w+b")

    def sync(self, file: IO[bytes]) -> None:
        """Wait until the written bytes are on the disk."""
        file.flush()
        os.fsync(file.fileno())

    def place(self, staged: Path, final: Path) -> None:
        """Rename a complete file to its final name, atomically. An existing file is replaced."""
        final.parent.mkdir(parents=True, exist_ok=True)
        os.replace(staged, final)

    def sync_path(self, path: Path) -> None:
        """Wait until a file, or the list of names in a folder, is on the disk."""
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def write(self, path: Path, data: bytes) -> None:
        """Write a whole file under a temporary name in the same folder, then rename it."""
        staged = path.with_name(path.name + STAGED_SUFFIX)
        with self.create(staged) as file:
            file.write(data)
            self.sync(file)
        self.place(staged, path)

    def remove(self, path: Path) -> None:
        """Remove a file or a folder, if it exists. Rename a folder first, so that after a crash a
        half-removed folder is not mistaken for a complete one."""
        if path.is_dir():
            renamed = path.with_name(REMOVED + path.name)
            os.replace(path, renamed)
            shutil.rmtree(renamed)
        else:
            path.unlink(missing_ok=True)

    def free_bytes(self, path: Path) -> int:
        return shutil.disk_usage(path).free


class Lock:
    """A lock on a folder, for one writing process at a time. The operating system releases it when the process
    ends."""

    def __init__(self, folder: Path) -> None:
        """Take the lock.

        Raises:
            DatasetError: Another process has locked the folder.
        """
        self._descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._descriptor)
            raise DatasetError(f"another process writes into {folder}. End that process first") from None

    @property
    def inside(self) -> Path:
        """A path to the locked folder that stays right if the folder is moved. Nothing is written elsewhere if its
        disk is unmounted."""
        return Path(f"/proc/self/fd/{self._descriptor}")

    def is_of(self, folder: Path) -> bool:
        """Return True if the path still leads to the locked folder. False if the folder was moved, or its disk
        unmounted."""
        try:
            return os.path.samestat(os.stat(folder), os.fstat(self._descriptor))
        except OSError:
            return False

    def release(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
