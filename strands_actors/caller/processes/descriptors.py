"""Check that this process may open as many files and sockets as a robot needs.

The check comes before anything is started. Otherwise the limit would be met later, inside a library.
"""

from __future__ import annotations

import errno
import os
import resource

FOR_LOOP = 24
"""Descriptors for the loop of a program and its zenoh session (17 were counted)."""
FOR_ROBOT = 20
"""Descriptors for one robot (16 were counted for the first robot of a program, 10 for each further one)."""


def require(count: int) -> None:
    """Raise ``OSError``, with the limit in its text, if fewer than ``count`` can be opened."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if limit == resource.RLIM_INFINITY:
        return
    try:
        # Do not count the descriptor that ``listdir`` itself opens.
        used = len(os.listdir("/dev/fd")) - 1
    except OSError as error:
        if error.errno not in (errno.EMFILE, errno.ENFILE):
            # This system has no list of open descriptors, so nothing can be checked.
            return
        used = limit
    if limit - used < count:
        raise OSError(
            f"too few open files are allowed: {limit}, of which {used} are open, and {count} more are needed. "
            "Raise the limit: ulimit -n 1024"
        )
