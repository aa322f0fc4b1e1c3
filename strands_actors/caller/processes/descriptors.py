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
"""Descriptors for the links of a tree and its start (16 were counted for the first tree, 10 for others)."""


def require(count: int) -> None:
    """Raise ``OSError``, with the limit in its text, if fewer than ``count`` can be opened."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if limit == resource.RLIM_INFINITY:
        return
    try:
        used = len(os.listdir("/dev/fd")) - 1  # without the descriptor of this listing
    except OSError as error:
        if error.errno not in (errno.EMFILE, errno.ENFILE):
            return  # This system has no such list.
        used = limit
    if limit - used < count:
        raise OSError(
            f"too few open files are allowed: {limit}, of which {used} are open, and {count} more are needed. "
            "raise the limit: ulimit -n 1024"
        )
