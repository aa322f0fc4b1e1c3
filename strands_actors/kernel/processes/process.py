"""Start child processes with a link, watch them by a pidfd, and fence them with SIGKILL.

Each child is a separate process group. So Ctrl-C in a terminal reaches only the user's script, and the tree
alone decides how to react to the script's end.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import subprocess
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import msgspec
import trio

from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.channels.permissions import Channel
from strands_actors.kernel.health.realtime import run_like_others, runs_first
from strands_actors.kernel.router import Router

from .interpreter import PYTHON, environment

NOTICED_S = 0.005
BURY_AFTER_S = 0.1
SIZE_BYTES = 4
"""Bytes of the size of a specification. The specification follows, and the descriptors come with the size."""
MAX_DESCRIPTORS = 8
FENCE_S = 1.0
"""Seconds that a fence waits for the end of the killed process. A process in an uninterruptible system call (a
serial adapter that hangs) ends when that call returns. Until then it runs no more of its code."""

# A child of a process with real-time priority drops that priority in its first line, since its imports take
# longer than the kernel lets such a process compute. Other kinds of scheduling were set by the user and stay,
# and not every process may leave them.
_BOOT = """
import os, sys
if hasattr(os, "sched_setscheduler") and os.sched_getscheduler(0) == os.SCHED_FIFO:
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
from strands_actors.kernel.processes.child import main
main(int(sys.argv[1]))
"""


class ChildSpecification(msgspec.Struct, frozen=True):
    """The first message to a child. ``entry`` is ``module:function``, which is called with (args, socket).
    Descriptors come with it (``specify``)."""

    entry: str
    args: dict[str, Any]


class ChildProcess(ABC):
    """A running child process and the link to it.

    Args:
        pid: Its process id.
        link_socket: This end of the link.
        pidfd: Identifies this very process, even after its id has been used again. None where the system has no
            pidfd (macOS). It belongs to this object.
    """

    def __init__(self, pid: int, link_socket: socket.socket, pidfd: int | None = None) -> None:
        self.pid = pid
        self.socket = link_socket
        self._pidfd = pidfd
        self._linked = False

    def __del__(self) -> None:
        pidfd = getattr(self, "_pidfd", None)
        if pidfd is not None:
            os.close(pidfd)

    @property
    @abstractmethod
    def alive(self) -> bool: ...

    def pidfds(self) -> tuple[int, ...]:
        """Return a duplicate of the pidfd to pass on, or nothing where there is no pidfd."""
        return () if self._pidfd is None else (os.dup(self._pidfd),)

    def kill(self, sig: int = signal.SIGKILL) -> None:
        """Signal the child. Do nothing if it has ended."""
        if not self.alive:
            return
        with contextlib.suppress(ProcessLookupError):  # ended, and not noticed yet
            if self._pidfd is None:
                os.kill(self.pid, sig)
            else:
                signal.pidfd_send_signal(self._pidfd, sig)

    @abstractmethod
    async def wait(self) -> int:
        """Wait until the process has ended. Return its exit code, or the negative number of the signal that
        ended it."""

    def part(self) -> None:  # noqa: B027  # a child of another parent is reaped there
        """Stop managing the child. It is still reaped when it ends."""

    def link(self, node: Router, channel: Channel | None = None) -> Link:
        """Return the parent's end of the link. The caller must run its ``run``. ``channel`` has the permissions
        of the child."""
        self._linked = True
        return Link(node, self.socket, channel=channel)

    async def fence(self, within_s: float = FENCE_S) -> bool:
        """Make sure that the process never writes again: kill it, wait for its end, and close the link.

        Args:
            within_s: Seconds to wait for the end.

        Returns:
            True if its end was seen in time. The caller may continue in either case, since a killed process
            runs no more of its code.
        """
        self.kill()
        with trio.CancelScope(shield=True, deadline=trio.current_time() + within_s) as scope:
            await self.wait()
        # A link on this socket notices the end of file by itself.
        if not self._linked:
            self.socket.close()
        return not scope.cancelled_caught

    async def drop(self, within_s: float = FENCE_S) -> None:
        """Fence the process and stop managing it. It is reaped even if its end was not seen in time."""
        if not await self.fence(within_s):
            self.part()

    async def _until_ended(self) -> None:
        """Return when the process has ended."""
        pidfd = self._pidfd
        if pidfd is None:
            await wait_for_end_of(self.pid)
            return
        try:
            # Only one task may wait for a descriptor, so each waits for a duplicate.
            fd = os.dup(pidfd)
        except OSError:  # no descriptor is free
            await _poll_until(lambda: _has_ended(pidfd))
        else:
            await _wait_readable(fd)


class Started(Protocol):
    """The part of ``subprocess.Popen`` that is used here."""

    pid: int

    def poll(self) -> int | None: ...

    def wait(self) -> int: ...


class OwnChild(ChildProcess):
    """A child of this process.

    A process with real-time priority (``health/realtime.py``) only looks at the end of its child. It leaves the
    waitpid to a thread of ordinary priority, later. In waitpid the kernel walks over the child's entries in
    /proc, and continues while one of the child's threads is not done with the same. A caller with real-time
    priority keeps that thread from its processor: two such roots on two processors walked for minutes, and
    wrote no safe frame.
    """

    def __init__(self, child: Started, link_socket: socket.socket) -> None:
        # Only this process reaps the child, so until then its id cannot be used again.
        super().__init__(child.pid, link_socket, _pidfd_of(child.pid))
        self._child = child
        self._code: int | None = None

    @property
    def alive(self) -> bool:
        return self._ended() is None

    def part(self) -> None:
        _reap_in_thread(self._child)

    async def wait(self) -> int:
        if self._pidfd is not None and self._ended() is None:
            await self._until_ended()
        while (code := self._ended()) is None:  # noqa: ASYNC110  # its end has been seen, or there is no pidfd
            await trio.sleep(NOTICED_S)
        return code

    def _ended(self) -> int | None:
        """Return the exit code, or None while the process runs."""
        if self._code is None:
            self._code = _exit_code(self._child)
            if self._code is not None and runs_first():
                trio.lowlevel.spawn_system_task(_reap_later, self._child)
            elif self._code is not None:
                self._child.wait()
        return self._code


def _exit_code(child: Started) -> int | None:
    if not hasattr(os, "waitid"):
        return child.poll()  # macOS has no real-time priority
    try:
        seen = os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:  # reaped
        return child.poll()
    if seen is None:
        return None
    return seen.si_status if seen.si_code == os.CLD_EXITED else -seen.si_status


async def _reap_later(child: Started) -> None:
    """Reap the child after ``BURY_AFTER_S``, when its parent has reacted to its end."""
    try:
        await trio.sleep(BURY_AFTER_S)
    finally:
        _reap_in_thread(child)


def _reap_in_thread(child: Started) -> None:
    try:
        threading.Thread(target=_reap, args=(child,), daemon=True).start()
    except RuntimeError:  # no thread can be started, so a child that has ended is reaped here
        child.poll()


def _reap(child: Started) -> None:
    run_like_others()
    child.wait()


def execute(link_fd: int, pass_fds: Sequence[int] = (), label: str = "") -> subprocess.Popen[bytes]:
    """Start a child by exec, which reads its specification from ``link_fd``.

    This process stands still until the child has begun: a few milliseconds, more on a busy machine.

    Args:
        link_fd: The child's end of the link.
        pass_fds: Further descriptors for the child.
        label: Shown by lists of processes.

    Raises:
        OSError: The process cannot be started.
    """
    return subprocess.Popen(
        [*PYTHON, "-c", _BOOT, str(link_fd), *([label] if label else [])],
        pass_fds=(link_fd, *pass_fds),
        stdin=subprocess.DEVNULL,
        process_group=0,
        env=environment(),
    )


def specify(
    link_socket: socket.socket, entry: str, args: Mapping[str, Any], descriptors: Sequence[int] = ()
) -> None:
    """Send a child its specification.

    The child gets duplicates of ``descriptors``. Their numbers in the child are in ``args["descriptors"]``.
    """
    specification = msgspec.msgpack.encode(ChildSpecification(entry, dict(args)))
    size = len(specification).to_bytes(SIZE_BYTES, "little")
    socket.send_fds(link_socket, [size], list(descriptors))
    link_socket.sendall(specification)


def start(
    entry: str,
    args: Mapping[str, Any],
    pass_fds: Sequence[int] = (),
    label: str = "",
    descriptors: Sequence[int] = (),
) -> ChildProcess:
    """Start a child by exec (``execute``) and send its specification (``specify``)."""
    ours, theirs = socket.socketpair()
    with theirs:
        popen = execute(theirs.fileno(), pass_fds, label)
    specify(ours, entry, args, descriptors)
    return OwnChild(popen, ours)


async def wait_for_end_of(pid: int) -> None:
    """Return when a process has ended, or at once if it does not exist."""
    try:
        fd = _pidfd_of(pid)
    except ProcessLookupError:
        return
    if fd is None:
        await _poll_until(lambda: not exists(pid))
    else:
        await _wait_readable(fd)


async def _wait_readable(fd: int) -> None:
    """Wait until a descriptor is readable, then close it."""
    try:
        await trio.lowlevel.wait_readable(fd)
    finally:
        trio.lowlevel.notify_closing(fd)
        os.close(fd)


def _pidfd_of(pid: int) -> int | None:
    """Return a pidfd, or None on macOS or if no descriptor is free. Raise ``ProcessLookupError``."""
    if not hasattr(os, "pidfd_open"):
        return None
    try:
        return os.pidfd_open(pid)
    except ProcessLookupError:
        raise
    except OSError:
        return None


async def _poll_until(condition: Callable[[], bool]) -> None:
    """Poll where no descriptor reports the end. It is noticed a little later then."""
    while not condition():  # noqa: ASYNC110  # no event to wait for: that is why we are here
        await trio.sleep(NOTICED_S)


def _has_ended(pidfd: int) -> bool:
    poll = select.poll()
    poll.register(pidfd, select.POLLIN)
    return bool(poll.poll(0))


def exists(pid: int) -> bool:
    """Return True if a process with this id exists, of any user. A process that has ended and was not reaped
    counts."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
