"""A child process: started with a link, watched by a pidfd, fenced with SIGKILL.

The child is a process group of its own, so that Ctrl-C in a terminal reaches only the user's
script; what the script's end means is then decided by the tree, not by who else got the signal.
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
"""Of a specification, which follow its size; the descriptors come with that."""
MAX_DESCRIPTORS = 8
FENCE_S = 1.0
"""How long a fence waits for the end of what it killed. A process in an uninterruptible system call
(a serial adapter that hangs) ends when that returns, and until then runs none of its own code."""

# A child of a process that runs first does not, from its first line on: its imports take longer than
# the kernel lets such a process compute. Any other way to be run is the user's wish, and not everybody
# may leave it.
_BOOT = """
import os, sys
if hasattr(os, "sched_setscheduler") and os.sched_getscheduler(0) == os.SCHED_FIFO:
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
from strands_actors.kernel.processes.child import main
main(int(sys.argv[1]))
"""


class ChildSpecification(msgspec.Struct, frozen=True):
    """What a child is told first. ``entry`` is ``module:function``, called with (args, socket).
    Descriptors come beside it (``specify``)."""

    entry: str
    args: dict[str, Any]


class ChildProcess(ABC):
    """A running child and the link to it. ``pidfd``: names this very process, whoever has its
    number later; None where the system has none (macOS). Belongs to this object."""

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
        """Return a duplicate of its pidfd, to give away; empty where there is none."""
        return () if self._pidfd is None else (os.dup(self._pidfd),)

    def kill(self, sig: int = signal.SIGKILL) -> None:
        """Signal the child; harmless when it is already gone."""
        if not self.alive:
            return
        with contextlib.suppress(ProcessLookupError):  # gone, and not yet noticed
            if self._pidfd is None:
                os.kill(self.pid, sig)
            else:
                signal.pidfd_send_signal(self._pidfd, sig)

    @abstractmethod
    async def wait(self) -> int:
        """Wait until the process is gone; its exit code (negative: the signal)."""

    def part(self) -> None:  # noqa: B027  # who has another parent is reaped by that one
        """Let it go on without us; it is reaped all the same."""

    def link(self, node: Router, channel: Channel | None = None) -> Link:
        """Return the parent's end; run its ``run``. ``channel``: what the child may say."""
        self._linked = True
        return Link(node, self.socket, channel=channel)

    async def fence(self, within_s: float = FENCE_S) -> bool:
        """Make sure it never writes again: SIGKILL, wait for it, close the link. Whether its end
        was seen ``within_s``: what was killed runs no code of its own, so who waits may go on after
        that."""
        self.kill()
        with trio.CancelScope(shield=True, deadline=trio.current_time() + within_s) as scope:
            await self.wait()
        # A link that runs on this socket sees the end of file by itself.
        if not self._linked:
            self.socket.close()
        return not scope.cancelled_caught

    async def drop(self, within_s: float = FENCE_S) -> None:
        """Fence it, and keep no hold on it: what has not been seen to end is reaped all the
        same."""
        if not await self.fence(within_s):
            self.part()

    async def _until_ended(self) -> None:
        """Return when the process has ended."""
        pidfd = self._pidfd
        if pidfd is None:
            await wait_for_end_of(self.pid)
            return
        try:
            fd = os.dup(pidfd)  # one task each may wait for a descriptor
        except OSError:  # none is free
            await _poll_until(lambda: _has_ended(pidfd))
        else:
            await _wait_readable(fd)


class Started(Protocol):
    """A child of this process: of ``subprocess.Popen``, what is used here."""

    pid: int

    def poll(self) -> int | None: ...

    def wait(self) -> int: ...


class OwnChild(ChildProcess):
    """A child of this very process.

    A process that runs before others (``health/realtime.py``) looks at its child's end, and leaves
    the waitpid to a thread of ordinary priority, later: in it the kernel walks over what is known of
    the child in /proc, and goes on walking while one of the child's own threads is not done with
    that. Who runs first keeps that thread from its processor: two such roots on two processors
    walked for minutes, and wrote no safe frame."""

    def __init__(self, child: Started, link_socket: socket.socket) -> None:
        # Nobody else reaps it: until we do, the number is its own.
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
        while (code := self._ended()) is None:  # noqa: ASYNC110  # its end has been seen, or nothing tells
            await trio.sleep(NOTICED_S)
        return code

    def _ended(self) -> int | None:
        """Return its exit code, once it has one."""
        if self._code is None:
            self._code = _exit_code(self._child)
            if self._code is not None and runs_first():
                trio.lowlevel.spawn_system_task(_reap_later, self._child)
            elif self._code is not None:
                self._child.wait()
        return self._code


def _exit_code(child: Started) -> int | None:
    if not hasattr(os, "waitid"):
        return child.poll()  # macOS, where nobody runs before everything else
    try:
        seen = os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:  # reaped
        return child.poll()
    if seen is None:
        return None
    return seen.si_status if seen.si_code == os.CLD_EXITED else -seen.si_status


async def _reap_later(child: Started) -> None:
    """When what its end calls for has been done."""
    try:
        await trio.sleep(BURY_AFTER_S)
    finally:
        _reap_in_thread(child)


def _reap_in_thread(child: Started) -> None:
    try:
        threading.Thread(target=_reap, args=(child,), daemon=True).start()
    except RuntimeError:  # no thread can be started: what has ended is reaped here
        child.poll()


def _reap(child: Started) -> None:
    run_like_others()
    child.wait()


def execute(link_fd: int, pass_fds: Sequence[int] = (), label: str = "") -> subprocess.Popen[bytes]:
    """Exec a child that reads its specification from ``link_fd``. Stops this process until the
    child has begun: a few milliseconds, more on a busy machine. ``label``: what a list of processes
    shows. Raise ``OSError``."""
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
    """Tell a child what to run. It has its own duplicates of ``descriptors``, whose numbers it finds
    in ``args["descriptors"]``."""
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
    """Start a child by exec, as ``execute``. ``descriptors``: see ``specify``."""
    ours, theirs = socket.socketpair()
    with theirs:
        popen = execute(theirs.fileno(), pass_fds, label)
    specify(ours, entry, args, descriptors)
    return OwnChild(popen, ours)


async def wait_for_end_of(pid: int) -> None:
    """Return when a process has ended (or never was)."""
    try:
        fd = _pidfd_of(pid)
    except ProcessLookupError:
        return
    if fd is None:
        await _poll_until(lambda: not exists(pid))
    else:
        await _wait_readable(fd)


async def _wait_readable(fd: int) -> None:
    """Wait, then close it."""
    try:
        await trio.lowlevel.wait_readable(fd)
    finally:
        trio.lowlevel.notify_closing(fd)
        os.close(fd)


def _pidfd_of(pid: int) -> int | None:
    """None where there is none: macOS, or no descriptor is free. Raise ``ProcessLookupError``."""
    if not hasattr(os, "pidfd_open"):
        return None
    try:
        return os.pidfd_open(pid)
    except ProcessLookupError:
        raise
    except OSError:
        return None


async def _poll_until(condition: Callable[[], bool]) -> None:
    """Where no descriptor tells, a death is noticed a little later."""
    while not condition():  # noqa: ASYNC110  # no event to wait for: that is why we are here
        await trio.sleep(NOTICED_S)


def _has_ended(pidfd: int) -> bool:
    poll = select.poll()
    poll.register(pidfd, select.POLLIN)
    return bool(poll.poll(0))


def exists(pid: int) -> bool:
    """Return whether there is a process of that number, whoever's; one that has ended and was not
    reaped counts."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
