"""What one simulated process has left of files, memory and threads."""

from __future__ import annotations

import errno
import os
from typing import Any

from strands_actors.kernel.processes.reserve import Reserve

LEAK, NO_FILES, NO_THREADS, NO_MEMORY = "leak", "no files", "no threads", "no memory"
"""``leak``: all files are in use, and those that are freed can be opened again."""


class Resources:
    """Of one process. ``lacks``: one of the kinds above, or empty."""

    def __init__(self) -> None:
        self.lacks = ""
        self.lacked = False
        self.freed_files = 0
        self.freed_bytes = 0
        self.reserve: dict[str, Any] = Reserve().__dict__

    def lack(self, kind: str) -> None:
        self.lacks, self.lacked = kind, True
        self.freed_files = self.freed_bytes = 0

    def open_file(self) -> None:
        """Raise ``OSError`` when there is none."""
        if self.lacks == LEAK and self.freed_files > 0:
            self.freed_files -= 1
        elif self.lacks in (LEAK, NO_FILES):
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        elif self.lacks == NO_MEMORY and not self.freed_bytes:
            raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))

    def close_file(self) -> None:
        self.freed_files += 1

    def map_bytes(self, size: int) -> None:
        if self.lacks == NO_MEMORY:
            if self.freed_bytes < size:
                raise MemoryError
            self.freed_bytes -= size

    def start_thread(self) -> None:
        """Raise ``RuntimeError`` when none can be started."""
        if self.lacks in (NO_THREADS, NO_MEMORY):
            raise RuntimeError("can't start new thread")
