"""Read how a thread uses the processor: does it compute, wait for a processor, or sleep?

Linux reports it. Elsewhere (macOS) the answer is None, and the caller has to decide by silence alone.
"""

from __future__ import annotations

import contextlib
import os
import signal
from typing import NamedTuple

import msgspec

CAN_TELL = os.path.exists("/proc/self/stat")
"""True if this system reports on other processes."""
_STOPPED = (b"T", b"t")
_FLUSHES = ("__flush_work", "flush_work")
"""The functions of the kernel that wait until its workers have delivered received data. The name differs by
version."""
# Column of the stolen time in /proc/stat, counted after the processor's name.
_STEAL = 8
# Columns of the flags and of the pending signals in /proc/pid/stat, counted after the process name.
_FLAGS, _SIGNALS = 6, 28
_EXITING = 0x4  # PF_EXITING of the kernel's sched.h
_STAT_BYTES = 4096
_JIFFY_NS = 1_000_000_000 // os.sysconf("SC_CLK_TCK")


class ProcessorUse(msgspec.Struct, frozen=True, gc=False):
    """How long a thread has computed and waited since it began, and its present state."""

    computed_ns: int
    # Time that the thread was ready to run and had no processor. A wait is added when it has ended.
    waited_ns: int
    # True if the thread runs, waits for a processor, or waits for a worker of the kernel (``kernel_workers``).
    ready: bool
    # True if a signal or a debugger has stopped the thread.
    stopped: bool = False
    # Time that the hypervisor took from each processor, in nanoseconds. Only ``suspected`` reads it.
    stolen_ns: tuple[int, ...] = ()


class Life(NamedTuple):
    """Whether a process is suspended (``stopped``) or ending (``dying``), by its main thread.

    Both fields are False if the system does not report the state, or if the process is gone.
    """

    # True if a signal or a debugger has stopped the process.
    stopped: bool = False
    # True if the process was killed or is exiting. It runs no more of its code, but needs a processor to end.
    dying: bool = False


def life_of(pid: int) -> Life:
    """Return whether a process is suspended or ending.

    Source: proc(5), /proc/pid/stat: the state, the flags and the pending signals.
    """
    try:
        # ``open()`` takes nine system calls for this, and the root does it 50 times per second.
        fd = os.open(f"/proc/{pid}/stat", os.O_RDONLY | os.O_CLOEXEC)
        try:
            return _life(os.read(fd, _STAT_BYTES))
        finally:
            os.close(fd)
    except OSError:
        return Life()


class StatFile:
    """Reads the state of another process from a file that is kept open, so that it needs no free descriptor."""

    def __init__(self, pid: int) -> None:
        self._fd: int | None = None
        # The process does not exist, or the system does not report on it.
        with contextlib.suppress(OSError):
            self._fd = os.open(f"/proc/{pid}/stat", os.O_RDONLY | os.O_CLOEXEC)

    def __del__(self) -> None:
        if self._fd is not None:
            os.close(self._fd)

    def life(self) -> Life:
        """As ``life_of``."""
        if self._fd is None:
            return Life()
        try:
            return _life(os.pread(self._fd, _STAT_BYTES, 0))
        except OSError:
            return Life()


def _life(stat: bytes) -> Life:
    fields = stat.rpartition(b")")[2].split()
    killed = bool(int(fields[_SIGNALS]) & 1 << signal.SIGKILL - 1)
    return Life(fields[0] in _STOPPED, killed or bool(int(fields[_FLAGS]) & _EXITING))


def is_stopped(pid: int) -> bool:
    """Return True if a process is suspended by a signal (SIGSTOP) or a debugger."""
    return life_of(pid).stopped


def processor_use(pid: int, thread: int | None = None) -> ProcessorUse | None:
    """Return the use of the processor by a thread, by default the main one.

    None where the system does not report it, or if the thread is gone. Source: sched-stats.rst and proc(5) of
    the kernel's documentation.
    """
    task = f"/proc/{pid}/task/{pid if thread is None else thread}"
    try:
        with open(f"{task}/schedstat", "rb") as schedstat, open(f"{task}/stat", "rb") as stat:
            computed, waited, _ = schedstat.read().split()
            state = _state(stat.read())
        ready = state == b"R" or (state == b"D" and _awaits_worker(task))
    except (OSError, ValueError):
        return None
    return ProcessorUse(int(computed), int(waited), ready, state in _STOPPED)


def _awaits_worker(task: str) -> bool:
    """Return True if a thread in uninterruptible sleep waits for the kernel's workers, not for a device.

    ``kernel_workers`` describes these workers.
    """
    with open(f"{task}/wchan") as wchan:
        return wchan.read() in _FLUSHES


def suspected(pid: int) -> ProcessorUse | None:
    """Return the processor use of a silent process, and the time that the hypervisor took from each processor.

    A sleeping thread is woken by the timer of a processor. While the hypervisor takes that processor away, the
    thread looks frozen and is not. The time is counted in steps of 10 ms since the machine started, and is zero
    on a machine that is not virtual. Source: proc_stat(5).
    """
    now = processor_use(pid)
    return None if now is None else msgspec.structs.replace(now, stolen_ns=_stolen_ns())


def _stolen_ns() -> tuple[int, ...]:
    with open("/proc/stat", "rb") as stat:
        rows = [line.split() for line in stat.read().split(b"\nintr ", 1)[0].splitlines()[1:]]
    return tuple(int(row[_STEAL]) * _JIFFY_NS for row in rows)


def _state(stat: bytes) -> bytes:
    """Return the state letter of a stat file. It follows the process name, which may contain any characters."""
    return stat.rpartition(b")")[2].split(None, 1)[0]


def pressure() -> float | None:
    """Return the share of the last 10 s in which a thread of this machine waited for a processor, 0 to 1.

    None where the system does not report it. Source: psi.rst of the kernel's documentation.
    """
    try:
        with open("/proc/pressure/cpu") as lines:
            return float(lines.readline().split("avg10=")[1].split()[0]) / 100
    except (OSError, IndexError, ValueError):
        return None
