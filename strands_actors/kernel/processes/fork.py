"""Fork children from a process with a single thread.

A forked child has all imports already. A child that is started by exec needs a quarter of a second of computing
for its imports.
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
"""Exit code of a child that another process or thread has reaped. It means no success."""


def fork_child(link_fd: int, keep: Sequence[int] = (), session: bool = False, name: Sequence[str] = ()) -> int:
    """Fork a child and return its pid.

    As after ``process.execute``, the child is in a new process group, has only the given descriptors, and gets its
    specification over ``link_fd``. This process must have only one thread.

    Args:
        link_fd: The child's end of the link.
        keep: Further descriptors that stay open in the child.
        session: True: the child begins a new session of processes, too.
        name: Process name of the child until its entry runs, as arguments of ``take_name``.
    """
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
    """A forked child of this process, with the interface of ``subprocess.Popen``."""

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
            # The child was reaped elsewhere in this process. It has ended, and its exit code is lost.
            except ChildProcessError:
                self._code = UNKNOWN
                return self._code
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code


class ForkedAhead:
    """One child that is forked in advance, and waits for its specification (the function to run) while a robot
    connects.

    Args:
        name: Process name of the waiting child, as arguments of ``take_name``. Without a name it keeps its
            parent's name, and a kill by name does not find it.
        keep: Descriptors that stay open in the child.
        session: True: the child begins a new session of processes, too.
    """

    def __init__(self, name: Sequence[str], keep: Sequence[int] = (), session: bool = False) -> None:
        self._socket, theirs = socket.socketpair()
        with theirs:
            self._child: Forked | None = Forked(fork_child(theirs.fileno(), keep, session, name))

    def start(self, entry: str, args: Mapping[str, Any], descriptors: Sequence[int] = ()) -> ChildProcess | None:
        """Send the child its specification (the function to run), as ``process.start`` does. Return None if it was
        started before or has ended."""
        forked, self._child = self._child, None
        if forked is None or forked.poll() is not None:
            return None
        specify(self._socket, entry, args, descriptors)
        return OwnChild(forked, self._socket)
