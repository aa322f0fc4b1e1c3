"""Reserve the resources that a stop needs, and end this process when it lacks them.

Each process that can stop a robot holds a few open files and a piece of address space in reserve. A stop begins
by freeing them. So a leak elsewhere in the process cannot keep the stop from opening its connections. Sometimes
the reserve is not enough, for example because no thread can be started. If a stop was not confirmed then, the
process exits at once with ``EXIT_SHORT``. The next process that can stop the robot has its own resources, and
it can act only when this one has ended.
"""

from __future__ import annotations

import _thread
import contextlib
import ctypes
import errno
import mmap
import os
import resource
import sys
from collections.abc import Callable, Iterator

FILES = 16
"""The number of open files in the reserve. A stop channel needs up to 8 files. A new stop process needs two
socket pairs, a pidfd and the pipe of ``Popen``. A UR needs three sockets.
"""
MEMORY_BYTES = 8 << 20
"""Address space in the reserve, in bytes. It is not touched, so it takes no memory."""
_PROBE_BYTES = 1 << 20
"""One arena of Python's allocator."""
MOST_FILES = 4096
"""The highest soft limit of open files that is set. On macOS a child closes all files up to this limit one by
one.
"""
EXIT_SHORT = 6
"""Exit code of a process that lacked what a stop needs."""

_RAISED = (
    resource.RLIMIT_NOFILE,
    resource.RLIMIT_AS,
    resource.RLIMIT_CPU,
    resource.RLIMIT_FSIZE,
    resource.RLIMIT_DATA,
)


def raise_limits() -> None:
    """Raise the soft limits of this process and its children (open files, address space and so on) to the hard
    ones.
    """
    for limit in _RAISED:
        soft, hard = resource.getrlimit(limit)
        new_soft = hard
        if limit == resource.RLIMIT_NOFILE:
            most = MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, MOST_FILES)
            new_soft = soft if soft == resource.RLIM_INFINITY else max(soft, most)
        if new_soft != soft:
            # macOS refuses to change some limits. They then stay as they are.
            with contextlib.suppress(OSError, ValueError):
                resource.setrlimit(limit, (new_soft, hard))


class Reserve:
    """The open files and the address space that one process holds in reserve for a stop. Nothing is reserved
    before ``begin``.
    """

    def __init__(self) -> None:
        self._files: list[int] = []
        self._memory: mmap.mmap | None = None
        self._begun = False
        self._stops = 0
        self._has_successor: Callable[[], bool] = lambda: False

    def begin(self, has_successor: Callable[[], bool]) -> None:
        """Reserve open files and address space for a stop.

        Args:
            has_successor: Returns True if another process stops the robot when this one ends. If it returns False,
                a lack of resources does not end this process, and a stop that has failed is tried again.
        """
        self._begun, self._has_successor = True, has_successor
        # Not every system has this library.
        with contextlib.suppress(OSError):
            # glibc opens this library when the first thread ends, and aborts the process if no file is free. So
            # open it now.
            ctypes.CDLL("libgcc_s.so.1")
        self.check()

    def check(self) -> str:
        """Reserve the open files and the address space that are missing in the reserve.

        Returns:
            The resource that this process lacks, for people. Empty if the reserve is complete and a little more
            is available.
        """
        if not self._begun:
            return ""
        try:
            if self._memory is None:
                self._memory = _address_space(MEMORY_BYTES)
            _address_space(_PROBE_BYTES).close()
        except (OSError, MemoryError):
            return "no memory is free (ulimit -v)"
        try:
            while len(self._files) < FILES:
                self._files.append(_open_file())
            os.close(_open_file())
        except OSError as error:
            if error.errno == errno.ENFILE and len(self._files) == FILES:
                # The whole system has no free file. The files in the reserve are worth more than a new process
                # would be.
                return ""
            limit = "sysctl fs.file-max" if error.errno == errno.ENFILE else "ulimit -n"
            return f"no file can be opened ({error.strerror}; {limit})"
        return ""

    @contextlib.contextmanager
    def freed(self) -> Iterator[None]:
        """Free the reserved files and address space within the block, for a stop, and reserve them again
        afterwards.
        """
        # Count the stop first, since another thread may check whether a stop uses the freed resources.
        self._stops += 1
        try:
            self._release()
            yield
        finally:
            self._stops -= 1
            if not self._stops:
                self.check()

    @property
    def is_freed(self) -> bool:
        """Return True while a stop uses the freed resources."""
        return self._stops > 0

    def lacked(self, error: BaseException) -> None:
        """End this process if a stop could not open a resource (``error``) and another process will then stop the
        robot. If there is no such process, do nothing.

        Code that opens a connection, a port or a process calls this before it turns the error into
        ``WireDown``. Otherwise the stop might be tried again for seconds, while the next process waits for the
        end of this one.
        """
        if self._stops and lacks_resources(error) and self._has_successor():
            end(str(error))

    def end_if_short(self) -> None:
        """End this process if it lacks a resource for a stop and another process will then stop the robot. If
        there is no such process, do nothing.

        Call it when a stop was not confirmed.
        """
        if not self._begun or not self._has_successor():
            return
        missing = self.check() or _lacks_thread()
        if missing:
            end(missing)

    def _release(self) -> None:
        files, self._files = self._files, []
        for fd in files:
            os.close(fd)
        if self._memory is not None:
            self._memory.close()
            self._memory = None


def end(missing: str) -> None:
    """End this process at once, because it lacks a resource."""
    with contextlib.suppress(Exception):
        print(
            f"process {os.getpid()} ended in a stop: {missing}. Another process of the robot makes it safe. "
            "Close other programs or raise the limit, then call resume()",
            file=sys.stderr,
            flush=True,
        )
    os._exit(EXIT_SHORT)


def how_ended(code: int) -> str:
    """Describe how a process ended, for people. ``code`` is the result of ``ChildProcess.wait``."""
    if code == EXIT_SHORT:
        return f"code {code}: it had no file, memory or thread for a stop"
    return f"signal {-code}" if code < 0 else f"code {code}"


def lacks_resources(error: BaseException) -> bool:
    """Return True if an exception, or one in its group, means that this process lacks a resource."""
    if isinstance(error, BaseExceptionGroup):
        return any(lacks_resources(part) for part in error.exceptions)
    if isinstance(error, OSError):
        return error.errno in (errno.EMFILE, errno.ENFILE, errno.ENOMEM)
    return isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and "start new thread" in str(error))


def _open_file() -> int:
    return os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC)


def _address_space(size: int) -> mmap.mmap:
    return mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)


def _lacks_thread() -> str:
    try:
        _thread.start_new_thread(int, ())
    except (RuntimeError, MemoryError):
        return "no thread can be started (ulimit -u, or a limit of the container)"
    return ""


RESERVE = Reserve()
"""The reserve of this process."""
