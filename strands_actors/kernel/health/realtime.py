"""Give a process real-time priority and keep it in memory: SCHED_FIFO and mlockall, where the system permits.

On a busy machine an ordinary process waits up to 28 ms for its turn, and far longer when its memory must first
be read from disk. A process with real-time priority waits 0.15 ms. It needs a second core, since a process that
spins keeps its core. A process that computes for ``SPELL_S`` without waiting once becomes an ordinary process
again.

The priorities follow one rule: a process that must be able to end another one has a higher priority.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

STANDBY_PRIORITY = 13
"""Priority of the standby process. It is above the root and the wire process, since the standby must be able to
end both. The standby does almost nothing while one of them runs.
"""
ROOT_PRIORITY = 12
WIRE_PRIORITY = 11
"""Priority of the wire process. It is below the root process, which must be able to end the wire process."""
KERNEL_PRIORITY = 10
"""Priority of the kernel's workers (see ``kernel_workers``). They also write files, and a process that keeps a
robot safe must not wait for the writing.
"""
TWIN_PRIORITY = 9
"""Priority of a simulated robot (twin). A real robot has a separate computer, so the twin runs before ordinary
programs. The twin computes most, so it is below the workers that carry its bytes.

A twin without this priority, but with nine times the share of an ordinary process (nice -10), was tried. It
takes no core from the caller, so a ``send_action`` takes a third less. But if a wire process gets the core of
the twin, the twin waits. Of the trials of Go2 and G1, ten times as many were late because of the machine.
"""

SPELL_S = 0.5
"""Seconds of computing after which a process loses its priority. No process of a robot computes for so long at
a time. Failure detectors end a silent process after 0.1 to 0.3 s. This limit is for the case that no process is
left that could end it.
"""
LAST_S = 2.0
"""Seconds of computing after which the kernel ends a process that cannot take a signal, such as one in a C
library that keeps the interpreter's lock.
"""

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # mman.h of Linux

_spent = False
_locked = False


def run_first(priority: int) -> None:
    """Request real-time priority and locked memory. ``scheduling`` and ``memory`` report what was granted.

    Call it in the main thread, after all imports.
    """
    global _locked
    if not hasattr(os, "sched_setscheduler"):
        return
    _locked = _lock_memory()
    if len(os.sched_getaffinity(0)) < 2:
        return
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        signal.signal(signal.SIGXCPU, _lower_priority)
        resource.setrlimit(resource.RLIMIT_RTTIME, (round(SPELL_S * 1e6), round(LAST_S * 1e6)))


def runs_first() -> bool:
    """Return True if the calling thread has real-time priority."""
    return hasattr(os, "sched_getscheduler") and os.sched_getscheduler(0) == os.SCHED_FIFO


def scheduling() -> str:
    """Return the scheduling of this process, for people."""
    if not hasattr(os, "sched_getscheduler"):
        return "ordinary: this system has no SCHED_FIFO"
    if runs_first():
        return f"SCHED_FIFO {os.sched_getparam(0).sched_priority}"
    if _spent:
        return f"ordinary: it computed for {SPELL_S:g} s without a pause"
    if len(os.sched_getaffinity(0)) < 2:
        return "ordinary: SCHED_FIFO needs a second core"
    return f"ordinary: SCHED_FIFO was not granted. Allow it with: ulimit -r {STANDBY_PRIORITY}"


def memory() -> str:
    """Return whether the memory of this process is locked, for people."""
    return "locked" if _locked else "not locked: this was not granted. Allow it with: ulimit -l unlimited"


def may_run_first() -> bool:
    """Return True if processes that this one starts are granted SCHED_FIFO."""
    before, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(STANDBY_PRIORITY))
    except PermissionError:
        return False
    os.sched_setscheduler(0, before, parameters)
    return True


def may_lock_memory() -> bool:
    """Return True if processes that this one starts may lock their memory. This process has nothing locked
    afterwards."""
    may = _lock_memory()
    ctypes.CDLL(None).munlockall()
    return may


def run_like_others() -> None:
    """Give up the real-time priority that this process inherited from its parent."""
    if runs_first():
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@contextlib.contextmanager
def run_as_before() -> Iterator[None]:
    """Restore the scheduling of this thread after the block, and apply it to threads that began in the block."""
    if not hasattr(os, "sched_setscheduler"):
        yield
        return
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    others = _threads() - {threading.get_native_id()}
    try:
        yield
    finally:
        _schedule(_threads() - others, policy, parameters)


def _threads() -> set[int]:
    return {int(thread) for thread in os.listdir("/proc/self/task")}


def _schedule(threads: set[int], policy: int, parameters: os.sched_param) -> None:
    for thread in threads:
        # The thread may have ended.
        with contextlib.suppress(ProcessLookupError):
            os.sched_setscheduler(thread, policy, parameters)


def _lower_priority(number: int, frame: FrameType | None) -> None:
    """Handle SIGXCPU, which means that a thread has computed for ``SPELL_S``. All threads lose their priority."""
    global _spent
    _spent = True
    _schedule(_threads(), os.SCHED_OTHER, os.sched_param(0))
    # The standard error stream may be closed.
    with contextlib.suppress(OSError, ValueError):
        print(f"process {os.getpid()} does not run first any more: {scheduling()}", file=sys.stderr, flush=True)


def _lock_memory() -> bool:
    """Lock present and future memory. Return True if that was granted.

    The memory is not loaded in advance, since the stacks of a dozen threads would take 100 MB.
    """
    return bool(ctypes.CDLL(None).mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) == 0)
