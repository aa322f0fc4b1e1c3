"""A child that is forked, from a process that has one thread: its imports are there, a quarter of a
second of computing that a child started by exec would need.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping, Sequence
from typing import Any

from . import child
from .identity import take_name
from .process import ChildProcess, OwnChild, specify

UNKNOWN = 1
"""Exit code of a child that this process did not see end: no success."""


def fork_child(link_fd: int, keep: Sequence[int] = (), session: bool = False, name: Sequence[str] = ()) -> int:
    """Return its pid. It is as one that ``process.execute`` starts: a process group of its own
    (with ``session`` a session too), no descriptor of anybody else's but those to ``keep``, told
    over ``link_fd`` what to run. ``name``: what it is called meanwhile, for ``take_name``. This
    process must have one thread."""
    pid = os.fork()
    if pid == 0:
        if session:
            os.setsid()
        else:
            os.setpgid(0, 0)
        first = 3
        for fd in sorted((link_fd, *keep)):
            os.closerange(first, fd)
            first = fd + 1
        os.closerange(first, os.sysconf("SC_OPEN_MAX"))
        if name:
            take_name(*name)
        child.main(link_fd)
    return pid


class Forked:
    """A child of this process, as ``subprocess.Popen`` shows one."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._code: int | None = None

    def poll(self) -> int | None:
        return self._wait(os.WNOHANG)

    def wait(self) -> int:
        code = self._wait(0)
        assert code is not None
        return code

    def _wait(self, options: int) -> int | None:
        if self._code is None:
            try:
                pid, status = os.waitpid(self.pid, options)
            except ChildProcessError:  # somebody else has reaped it: ended, nobody knows how
                self._code = UNKNOWN
                return self._code
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code


class ForkedAhead:
    """One child, forked now; it waits to be told what to run, for as long as a robot takes to connect.

    Args:
        name: What it is called from now on, for ``take_name``. Without one it has its parent's name,
            and who kills by name misses that.
        keep: Descriptors that it is given.
        session: See ``fork_child``.
    """

    def __init__(self, name: Sequence[str], keep: Sequence[int] = (), session: bool = False) -> None:
        self._socket, theirs = socket.socketpair()
        with theirs:
            self._child: Forked | None = Forked(fork_child(theirs.fileno(), keep, session, name))

    def start(self, entry: str, args: Mapping[str, Any], descriptors: Sequence[int] = ()) -> ChildProcess | None:
        """As ``process.start``. None when it was started before, or has ended. ``descriptors``: see
        ``process.specify``."""
        forked, self._child = self._child, None
        if forked is None or forked.poll() is not None:
            return None
        specify(self._socket, entry, args, descriptors)
        return OwnChild(forked, self._socket)
