"""Whether this process may open as many files and sockets as a robot needs: it is asked before
anything is started, since a limit that is met half way is met within a library."""

from __future__ import annotations

import errno
import os
import resource

FOR_LOOP = 24
"""The loop of a program and its zenoh session: 17 were counted."""
FOR_ROBOT = 20
"""A tree's links and lines, and its start: 16 were counted for the first, 10 for others."""


def require(count: int) -> None:
    """Raise ``OSError`` that names the limit when fewer can be opened."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if limit == resource.RLIM_INFINITY:
        return
    try:
        used = len(os.listdir("/dev/fd")) - 1  # less the one that lists
    except OSError as error:
        if error.errno not in (errno.EMFILE, errno.ENFILE):
            return  # a system that does not tell
        used = limit
    if limit - used < count:
        raise OSError(
            f"too few open files are allowed: {limit}, of which {used} are open, and {count} more are needed. "
            "raise the limit: ulimit -n 1024"
        )
