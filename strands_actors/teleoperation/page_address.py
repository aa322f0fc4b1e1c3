"""Write the address of the operator's page to a file, from which the caller's process reads it."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


def write_address(path: Path, text: str) -> None:
    """Write the page's address to a file that only the user can read. Other programs never see a part of the
    address.
    """
    new = path.with_suffix(f".{os.getpid()}.new")
    with contextlib.suppress(FileNotFoundError):
        new.unlink()
    with open(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(text)
    os.replace(new, path)
