"""Start child processes with a link (a socket), notice their end by a pidfd, and kill them with SIGKILL.

Each child is a separate process group. So Ctrl-C in a terminal reaches only the user's script, and the robot's
processes decide how to react to the script's end.
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
"""Length in bytes of the field with the size of a specification. The specification follows this field.
Descriptors are sent with the field.
"""
MAX_DESCRIPTORS = 8
FENCE_S = 1.0
"""Longest time in seconds to wait for the end of a killed process. A process in an uninterruptible system call
(a serial adapter that hangs) ends when that call returns. Until then it runs no more of its code.
"""

# A child inherits real-time priority. It gives up that priority in its first line, since the kernel does not
# let such a process compute as long as the imports take. A user may have chosen other kinds of scheduling, so
# they stay. Besides, not every process may leave them.
_BOOT = """
import os, sys
if hasattr(os, "sched_setscheduler") and os.sched_getscheduler(0) == os.SCHED_FIFO:
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
from strands_actors.kernel.processes.child import main
main(int(sys.argv[1]))
"""


class ChildSpecification(msgspec.Struct, frozen=True):
    """The first message to a child process, which names the function to run.

    ``entry`` is ``module:function``. The function is called with (args, socket). Descriptors come with the
    message (``specify``).
    """

    entry: str
    args: dict[str, Any]


class ChildProcess(ABC):
    """A running child process and the link to it.

    Args:
        pid: Process id of the child.
        link_socket: This end of the link.
        pidfd: A descriptor that identifies the child, even after its id has been used again. None where the
            system has no pidfd (macOS). This object closes it.
    """

    def __init__(self, pid: int, link_socket: socket.socket, pidfd: int | None = None) -> None:
        self.pid = pid
        self.socket = link_socket
        self._pidfd = pidfd
        self._linked = False

    # At the end of the interpreter the module ``os`` may already be gone, so its function is kept here.
    def __del__(self, _close: Callable[[int], None] = os.close) -> None:
        pidfd = getattr(self, "_pidfd", None)
        if pidfd is not None:
            _close(pidfd)

    @property
    @abstractmethod
    def alive(self) -> bool: ...

    def pidfds(self) -> tuple[int, ...]:
        """Return a duplicate of the pidfd, to pass it to another process. The result is empty without a pidfd."""
        return () if self._pidfd is None else (os.dup(self._pidfd),)

    def kill(self, sig: int = signal.SIGKILL) -> None:
        """Signal the child. Do nothing if it has ended."""
        if not self.alive:
            return
        # The process may have ended unnoticed.
        with contextlib.suppress(ProcessLookupError):
            if self._pidfd is None:
                os.kill(self.pid, sig)
            else:
                signal.pidfd_send_signal(self._pidfd, sig)

    @abstractmethod
    async def wait(self) -> int:
        """Wait until the process has ended. Return its exit code, or the negative number of the signal that
        ended it."""

    def detach(self) -> None:  # noqa: B027  # a child of another parent is reaped there
        """Stop managing the child. It is still reaped when it ends."""

    def link(self, node: Router, channel: Channel | None = None) -> Link:
        """Return the parent's end of the link (the socket to the child). The caller must call its method ``run``.
        ``channel`` has the permissions of the child."""
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
        # If a link uses this socket, the link notices the end of the connection and closes the socket.
        if not self._linked:
            self.socket.close()
        return not scope.cancelled_caught

    async def drop(self, within_s: float = FENCE_S) -> None:
        """Kill the process (``fence``) and stop managing it. It is reaped even if its end was not seen in time."""
        if not await self.fence(within_s):
            self.detach()

    async def _until_ended(self) -> None:
        """Return when the process has ended."""
        pidfd = self._pidfd
        if pidfd is None:
            await wait_for_end_of(self.pid)
            return
        try:
            # Only one task may wait for a descriptor, so each task waits for a duplicate of it.
            fd = os.dup(pidfd)
        except OSError:
            # No descriptor is free, so check the process repeatedly.
            await _poll_until(lambda: _has_ended(pidfd))
        else:
            await _wait_readable(fd)


class Started(Protocol):
    """The methods of ``subprocess.Popen`` that this module uses."""

    pid: int

    def poll(self) -> int | None: ...

    def wait(self) -> int: ...


class OwnChild(ChildProcess):
    """A child of this process.

    A process with real-time priority (``health/realtime.py``) does not reap its child when the child ends. A
    thread of ordinary priority calls waitpid later. In waitpid the kernel walks over the child's entries in /proc.
    It continues until the child's threads have finished the same walk. A caller with real-time priority keeps
    these threads from its processor. Two such root processes on two processors walked for minutes, and did not
    stop their robots.
    """

    def __init__(self, child: Started, link_socket: socket.socket) -> None:
        # Only this process reaps the child. Its id cannot be used again before that.
        super().__init__(child.pid, link_socket, _pidfd_of(child.pid))
        self._child = child
        self._code: int | None = None

    @property
    def alive(self) -> bool:
        return self._ended() is None

    def detach(self) -> None:
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
        # macOS has no real-time priority, so the child can be reaped at once.
        return child.poll()
    try:
        result = os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        # The child was reaped before.
        return child.poll()
    if result is None:
        return None
    return result.si_status if result.si_code == os.CLD_EXITED else -result.si_status


async def _reap_later(child: Started) -> None:
    """Reap the child ``BURY_AFTER_S`` later, when its parent has reacted to the child's end."""
    try:
        await trio.sleep(BURY_AFTER_S)
    finally:
        _reap_in_thread(child)


def _reap_in_thread(child: Started) -> None:
    try:
        threading.Thread(target=_reap, args=(child,), daemon=True).start()
    except RuntimeError:
        # No thread can be started, so reap a child that has ended here.
        child.poll()


def _reap(child: Started) -> None:
    run_like_others()
    child.wait()


def execute(link_fd: int, pass_fds: Sequence[int] = (), label: str = "") -> subprocess.Popen[bytes]:
    """Start a child by exec, which reads its specification from ``link_fd``.

    This process is blocked until the child has begun. That takes a few milliseconds, and more on a busy
    machine.

    Args:
        link_fd: The child's end of the link.
        pass_fds: Further descriptors for the child.
        label: Text that ``ps`` shows for the child.

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
    """Wait until a descriptor is readable, then close the descriptor."""
    try:
        await trio.lowlevel.wait_readable(fd)
    finally:
        trio.lowlevel.notify_closing(fd)
        os.close(fd)


def _pidfd_of(pid: int) -> int | None:
    """Return a pidfd (a descriptor for the process), or None on macOS or if no descriptor is free. Raise
    ``ProcessLookupError`` if the process does not exist.
    """
    if not hasattr(os, "pidfd_open"):
        return None
    try:
        return os.pidfd_open(pid)
    except ProcessLookupError:
        raise
    except OSError:
        return None


async def _poll_until(condition: Callable[[], bool]) -> None:
    """Check a condition repeatedly, where no descriptor reports the end of a process.

    The end is then noticed a little later.
    """
    while not condition():  # noqa: ASYNC110  # no event to wait for: that is why we are here
        await trio.sleep(NOTICED_S)


def _has_ended(pidfd: int) -> bool:
    poll = select.poll()
    poll.register(pidfd, select.POLLIN)
    return bool(poll.poll(0))


def exists(pid: int) -> bool:
    """Return True if a process with this id exists, of any user. A process that has ended and was not reaped
    counts as existing.
    """
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def state_of(pid: int) -> str:
    """Ask the operating system for the state of a process. Return ``running``, ``frozen`` or ``ended``."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            letter = file.read().rpartition(")")[2].split()[0]
    except ProcessLookupError:
        return "ended"
    except FileNotFoundError:
        return "running" if not os.path.exists("/proc/self/stat") and exists(pid) else "ended"
    return {"T": "frozen", "t": "frozen", "Z": "ended", "X": "ended"}.get(letter, "running")
