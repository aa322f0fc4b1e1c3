"""Count the files, memory and threads that a simulated process can still get."""

from __future__ import annotations

import errno
import os
from typing import Any

from strands_actors.kernel.processes.reserve import Reserve

LEAK, NO_FILES, NO_THREADS, NO_MEMORY = "leak", "no files", "no threads", "no memory"
"""After a ``leak`` all descriptors are in use. Those that are closed can be opened again."""


class Resources:
    """The resources of one process.

    Attributes:
        lacks: One of the faults above, or empty.
        lacked: True once there was such a fault.
    """

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
        """Take a descriptor.

        Raises:
            OSError: No descriptor is free.
        """
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
        """Start a thread.

        Raises:
            RuntimeError: No thread can be started.
        """
        if self.lacks in (NO_THREADS, NO_MEMORY):
            raise RuntimeError("can't start new thread")
