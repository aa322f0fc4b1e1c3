"""What the system says of a thread and the processor: has it computed, has it stood in line, is it
asleep?

Linux tells; elsewhere (macOS) the answer is None, and who asks goes by silence alone.
"""

from __future__ import annotations

import contextlib
import os
import signal
from typing import NamedTuple

import msgspec

CAN_TELL = os.path.exists("/proc/self/stat")
"""Whether this system tells of other processes."""
_STOPPED = (b"T", b"t")
_FLUSHES = ("__flush_work", "flush_work")
"""The kernel's functions that wait until its workers have handed on what was received; the name
differs by version."""
_STEAL = 8  # the column, behind the processor's name
_FLAGS, _SIGNALS = 6, 28  # columns of /proc/pid/stat, behind the name
_EXITING = 0x4  # PF_EXITING of the kernel's sched.h
_STAT_BYTES = 4096
_JIFFY_NS = 1_000_000_000 // os.sysconf("SC_CLK_TCK")


class Standing(msgspec.Struct, frozen=True, gc=False):
    """Totals since the thread began."""

    computed_ns: int
    waited_ns: int  # ready to run, and no processor free; counted when the wait is over
    ready: bool  # it, or a worker of the kernel that it waits for, runs, or would if there were a processor
    stopped: bool = False  # by a signal or a debugger
    stolen_ns: tuple[int, ...] = ()  # per processor, by the machine beneath this virtual one: see ``suspected``


class Life(NamedTuple):
    """Of a process, by its main thread. Both false where the system does not tell, or the process
    is gone."""

    stopped: bool = False  # by a signal or for a debugger
    dying: bool = False  # killed, or on its way out: it needs a processor to end, and runs no code of its own


def life_of(pid: int) -> Life:
    """Source: proc(5), /proc/pid/stat: the state, the flags and the pending signals."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as stat:
            return _life(stat.read())
    except OSError:
        return Life()


class StatFile:
    """The state of another process, from a file that is kept open: who has no free descriptor can
    still read it."""

    def __init__(self, pid: int) -> None:
        self._fd: int | None = None
        with contextlib.suppress(OSError):  # no such process, or a system that does not tell
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
    """Return whether the system has stopped a process."""
    return life_of(pid).stopped


def standing(pid: int, thread: int | None = None) -> Standing | None:
    """Of a process's main thread, or of the given one. None where the system does not tell, or it
    is gone. Source: sched-stats.rst and proc(5) of the kernel's documentation."""
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
    """Return whether a thread that cannot be interrupted waits for the kernel's workers (see
    ``kernel_workers``), rather than for a device."""
    with open(f"{task}/wchan") as wchan:
        return wchan.read() in _FLUSHES


def suspected(pid: int) -> Standing | None:
    """Of the main thread of a process that has fallen silent, with what the hypervisor took from
    each processor. A thread that sleeps on a processor that was taken away is not woken by its
    timer: it looks frozen, and is not. Counted in steps of 10 ms, since the machine started; zero
    on one that is not virtual. Source: proc_stat(5)."""
    now = standing(pid)
    return None if now is None else msgspec.structs.replace(now, stolen_ns=_stolen_ns())


def _stolen_ns() -> tuple[int, ...]:
    with open("/proc/stat", "rb") as stat:
        rows = [line.split() for line in stat.read().split(b"\nintr ", 1)[0].splitlines()[1:]]
    return tuple(int(row[_STEAL]) * _JIFFY_NS for row in rows)


def _state(stat: bytes) -> bytes:
    """Return the letter behind the name, which may hold anything."""
    return stat.rpartition(b")")[2].split(None, 1)[0]


def pressure() -> float | None:
    """For how much of the last 10 s something of this machine stood in line for a processor: 0 to 1.
    None where the system does not tell. Source: psi.rst of the kernel's documentation."""
    try:
        with open("/proc/pressure/cpu") as lines:
            return float(lines.readline().split("avg10=")[1].split()[0]) / 100
    except (OSError, IndexError, ValueError):
        return None
