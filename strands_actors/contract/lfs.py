"""Recognise the pointer that git leaves in place of a large file when git-lfs is not installed."""

from __future__ import annotations

from pathlib import Path

_POINTER = b"version https://git-lfs.github.com/spec/"


def pointer_reason(file: Path) -> str:
    """Return an error text if a file is only the pointer of git-lfs, or an empty text if it is the file itself.

    Raises:
        OSError: The file cannot be read.
    """
    with file.open("rb") as opened:
        is_pointer = opened.read(len(_POINTER)) == _POINTER
    return f"{file} is a git-lfs pointer, not the file itself. Run: git lfs pull" if is_pointer else ""
