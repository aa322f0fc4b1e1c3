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
_STEAL = 8  # column of /proc/stat, behind the processor's name
_FLAGS, _SIGNALS = 6, 28  # columns of /proc/pid/stat, behind the name
_EXITING = 0x4  # PF_EXITING of the kernel's sched.h
_STAT_BYTES = 4096
_JIFFY_NS = 1_000_000_000 // os.sysconf("SC_CLK_TCK")


class Standing(msgspec.Struct, frozen=True, gc=False):
    """The use of the processor by a thread, in totals since it began."""

    computed_ns: int
    waited_ns: int  # ready to run without a free processor; counted when the wait is over
    # True if the thread runs or waits for a processor, or a worker of the kernel that it waits for does.
    ready: bool
    stopped: bool = False  # by a signal or a debugger
    # Per processor: time taken by the host of this virtual machine (``suspected``).
    stolen_ns: tuple[int, ...] = ()


class Life(NamedTuple):
    """The state of a process, from its main thread. Both are False where the system does not report it, or if
    the process is gone."""

    stopped: bool = False  # by a signal or for a debugger
    # Killed or exiting. The process needs a processor to end, but runs no more of its code.
    dying: bool = False


def life_of(pid: int) -> Life:
    """Return the state of a process.

    Source: proc(5), /proc/pid/stat: the state, the flags and the pending signals.
    """
    try:
        with open(f"/proc/{pid}/stat", "rb") as stat:
            return _life(stat.read())
    except OSError:
        return Life()


class StatFile:
    """Reads the state of another process from a file that is kept open, so that it needs no free descriptor."""

    def __init__(self, pid: int) -> None:
        self._fd: int | None = None
        with contextlib.suppress(OSError):  # no such process, or a system that does not report it
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
    """Return True if the system has stopped a process."""
    return life_of(pid).stopped


def standing(pid: int, thread: int | None = None) -> Standing | None:
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
    return Standing(int(computed), int(waited), ready, state in _STOPPED)


def _awaits_worker(task: str) -> bool:
    """Return True if an uninterruptible thread waits for the kernel's workers (``kernel_workers``), and not for
    a device."""
    with open(f"{task}/wchan") as wchan:
        return wchan.read() in _FLUSHES


def suspected(pid: int) -> Standing | None:
    """Return the use of the processor by a silent process, with the time that the hypervisor took from each
    processor.

    A thread that sleeps on a processor that was taken away is not woken by its timer. It looks frozen and is
    not. The time is counted in steps of 10 ms since the machine started, and is zero on a machine that is not
    virtual. Source: proc_stat(5).
    """
    now = standing(pid)
    return None if now is None else msgspec.structs.replace(now, stolen_ns=_stolen_ns())


def _stolen_ns() -> tuple[int, ...]:
    with open("/proc/stat", "rb") as stat:
        rows = [line.split() for line in stat.read().split(b"\nintr ", 1)[0].splitlines()[1:]]
    return tuple(int(row[_STEAL]) * _JIFFY_NS for row in rows)


def _state(stat: bytes) -> bytes:
    """Return the letter behind the name, which may contain any characters."""
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
