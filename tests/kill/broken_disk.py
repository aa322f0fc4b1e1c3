"""Break the disk of one directory: its path is missing, it is full, or it is read-only.

A bench can also have a small ``/dev/shm``, which can be filled.
"""

from __future__ import annotations

import contextlib
import enum
import errno
import subprocess
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

from strands_actors.testing import template

CAP_SYS_ADMIN = 21
SIZE = "256k"
FILES = 400
"""Number of files of a small disk."""
SMALL = f"size={SIZE},nr_inodes={FILES}"
SHARED_MEMORY = "/dev/shm"
_FILLER = "filler"


class Disk(enum.StrEnum):
    GONE = "gone"
    FULL = "full"
    READ_ONLY = "read-only"


def can_mount() -> bool:
    """Return whether this process may mount a file system."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    effective = next((line.split()[1] for line in lines if line.startswith("CapEff:")), "0")
    return bool(int(effective, 16) >> CAP_SYS_ADMIN & 1)


@contextlib.contextmanager
def small(path: Path) -> Iterator[None]:
    """Mount a small disk over an empty directory."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"{SMALL},mode=0700", "tmpfs", str(path)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(path)], check=True)


@contextlib.contextmanager
def small_shared_memory() -> Iterator[None]:
    """Give the callers of a bench that starts in this context a small ``/dev/shm``.

    The processes of their robots have it, too. It is mounted in a mount namespace of the bench, so no other
    program sees it.
    """
    mount = f'mount -t tmpfs -o {SMALL},mode=1777 tmpfs {SHARED_MEMORY} && exec "$@"'
    python = ("unshare", "--mount", "sh", "-c", mount, "sh", *template.PYTHON)
    with mock.patch.object(template, "PYTHON", python):
        yield


@contextlib.contextmanager
def full_shared_memory(pid: int) -> Iterator[None]:
    """Fill the ``small_shared_memory`` that a process has."""
    path = Path(f"/proc/{pid}/root{SHARED_MEMORY}")
    assert path.stat().st_dev != Path(SHARED_MEMORY).stat().st_dev, "other programs use this memory, too"
    try:
        fill(path)
        yield
    finally:
        for filler in path.glob(f"{_FILLER}*"):
            filler.unlink()


@contextlib.contextmanager
def broken(path: Path, how: Disk) -> Iterator[None]:
    """Break the disk of a directory. A disk that becomes full must be ``small``."""
    match how:
        case Disk.GONE:
            aside = path.with_name(f"{path.name}-aside")
            path.rename(aside)
            path.touch()
            try:
                yield
            finally:
                path.unlink()
                aside.rename(path)
        case Disk.FULL:
            fill(path)
            yield
        case Disk.READ_ONLY:
            subprocess.run(["mount", "--bind", str(path), str(path)], check=True)
            try:
                subprocess.run(["mount", "-o", "remount,bind,ro", str(path)], check=True)
                yield
            finally:
                subprocess.run(["umount", "-l", str(path)], check=True)


def fill(path: Path) -> None:
    """Use up first all bytes and then all files of a small disk."""
    with contextlib.suppress(OSError), (path / _FILLER).open("wb", buffering=0) as filler:
        while filler.write(bytes(4096)):
            pass
    try:
        for number in range(FILES + 1):
            (path / f"{_FILLER}-{number}").touch()
    except OSError as error:
        assert error.errno == errno.ENOSPC
    else:
        raise AssertionError(f"{path} is not full")
