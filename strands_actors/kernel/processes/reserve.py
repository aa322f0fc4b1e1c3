"""Reserve the resources that a stop needs, and end this process when they cannot be had.

Root, wire, standby and stop process each hold a few open files and a piece of address space. A stop begins by
freeing them. So a leak elsewhere in the process cannot keep the stop from opening its connections. Sometimes
that is not enough: a limit was lowered, or no thread can be started. If a stop was not confirmed then, the
process exits at once with ``EXIT_SHORT``. The next process has its own resources, and it can act only when this
one has ended.
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
"""The number of open files that are held. The stop channel that needs most of them (a new stop process: two
socket pairs, a pidfd, the pipe of ``Popen``; a UR: three sockets) needs 8."""
MEMORY_BYTES = 8 << 20
"""Address space that is held. It is not touched, so it takes no memory."""
_PROBE_BYTES = 1 << 20
"""One arena of Python's allocator."""
MOST_FILES = 4096
"""The highest soft limit of open files that is set. On macOS a child closes them one by one."""
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
    """Raise the soft limits of this process, and of its children, to the hard ones."""
    for limit in _RAISED:
        soft, hard = resource.getrlimit(limit)
        wanted = hard
        if limit == resource.RLIMIT_NOFILE:
            most = MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, MOST_FILES)
            wanted = soft if soft == resource.RLIM_INFINITY else max(soft, most)
        if wanted != soft:
            with contextlib.suppress(OSError, ValueError):  # macOS refuses some: then the limit stays
                resource.setrlimit(limit, (wanted, hard))


class Reserve:
    """The reserve of one process. It does nothing until ``begin``."""

    def __init__(self) -> None:
        self._files: list[int] = []
        self._memory: mmap.mmap | None = None
        self._begun = False
        self._stops = 0
        self._other_acts: Callable[[], bool] = lambda: False

    def begin(self, other_acts: Callable[[], bool]) -> None:
        """Take the reserve.

        Args:
            other_acts: Returns True if another process stops the robot when this one ends. Otherwise this
                process stays and tries again.
        """
        self._begun, self._other_acts = True, other_acts
        with contextlib.suppress(OSError):  # not every system has this library
            # glibc opens this library when the first thread ends, and aborts the process if no file is free.
            ctypes.CDLL("libgcc_s.so.1")
        self.check()

    def check(self) -> str:
        """Take the missing parts of the reserve.

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
                # The whole system has no free file. Those in the reserve are worth more than a new process.
                return ""
            limit = "sysctl fs.file-max" if error.errno == errno.ENFILE else "ulimit -n"
            return f"no file can be opened ({error.strerror}; {limit})"
        return ""

    @contextlib.contextmanager
    def freed(self) -> Iterator[None]:
        """Free the reserve for a stop, and take it again afterwards."""
        # Counted first: another thread may check whether a stop uses the freed resources.
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
        """Return True while a stop is being carried out."""
        return self._stops > 0

    def lacked(self, error: BaseException) -> None:
        """End this process if ``error`` kept a stop from opening a resource, and another process stops the
        robot then.

        Code that opens a connection, a port or a process calls this before it turns the error into
        ``WireDown``. A stop channel may try again for seconds, and the next process waits until this one has
        ended.
        """
        if self._stops and lacks_resources(error) and self._other_acts():
            end(str(error))

    def end_if_short(self) -> None:
        """End this process if it lacks a resource for a stop, and another process stops the robot then.

        Call it when a stop was not confirmed.
        """
        if not self._begun or not self._other_acts():
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
