"""Break the disk of one directory: its path is missing, it is full, or it is read-only."""

from __future__ import annotations

import contextlib
import enum
import errno
import subprocess
from collections.abc import Iterator
from pathlib import Path

CAP_SYS_ADMIN = 21
SIZE = "256k"
FILES = 400
"""Number of files of a small disk."""


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
    options = f"size={SIZE},nr_inodes={FILES},mode=0700"
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(path)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(path)], check=True)


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
    with contextlib.suppress(OSError), (path / "filler").open("wb", buffering=0) as filler:
        while filler.write(bytes(4096)):
            pass
    try:
        for number in range(FILES + 1):
            (path / f"filler-{number}").touch()
    except OSError as error:
        assert error.errno == errno.ENOSPC
    else:
        raise AssertionError(f"{path} is not full")
