"""A process that runs before others and stays in memory: SCHED_FIFO and mlockall, where the system
grants them.

On a busy machine an ordinary process waits up to 28 ms for its turn, and far longer when its memory
has to be read from disk first; one of these waits 0.15 ms. It needs a second core, since a process
that spins keeps the core it is on. It does not keep it for long: who computes for ``SPELL_S``
without once waiting becomes an ordinary process again.
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
"""Above both, which it has to be able to end. It does next to nothing as long as one of them
lives."""
ROOT_PRIORITY = 12
WIRE_PRIORITY = 11
"""Below the root, which has to be able to end it."""
KERNEL_PRIORITY = 10
"""Of the kernel's workers (see ``kernel_workers``): they also write files, for which nothing that
keeps a robot safe is to wait."""
TWIN_PRIORITY = 9
"""The robot has a computer of its own. It computes most: the bytes between the two come first.

An ordinary process with nine times the share (nice -10) takes no core from the caller: a
``send_action`` takes a third less. But where a wire process ends on its core, it waits: of the
Go2's and G1's trials ten times as many were late because of the machine."""

SPELL_S = 0.5
"""Longer than any process of a tree computes at a time. The failure detectors end who is silent for
0.1 to 0.3 s before that; this is for when nobody is left to do so."""
LAST_S = 2.0
"""The kernel ends a process that computes for so long and cannot take a signal: a C library that
keeps the interpreter."""

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # mman.h of Linux

_spent = False
_locked = False


def run_first(priority: int) -> None:
    """Ask for both; ``scheduling`` and ``memory`` say what was granted. Call it in the main thread,
    with everything imported."""
    global _locked
    if not hasattr(os, "sched_setscheduler"):
        return
    _locked = _lock_memory()
    if len(os.sched_getaffinity(0)) < 2:
        return
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        signal.signal(signal.SIGXCPU, _give_way)
        resource.setrlimit(resource.RLIMIT_RTTIME, (round(SPELL_S * 1e6), round(LAST_S * 1e6)))


def runs_first() -> bool:
    """Of the calling thread."""
    return hasattr(os, "sched_getscheduler") and os.sched_getscheduler(0) == os.SCHED_FIFO


def scheduling() -> str:
    """Return how this process is run, for people."""
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
    """Return whether this process can be moved out of memory, for people."""
    return "locked" if _locked else "not locked: this was not granted. Allow it with: ulimit -l unlimited"


def may_run_first() -> bool:
    """Return whether processes that this one starts are granted SCHED_FIFO."""
    before, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(STANDBY_PRIORITY))
    except PermissionError:
        return False
    os.sched_setscheduler(0, before, parameters)
    return True


def may_lock_memory() -> bool:
    """Return whether processes that this one starts may stay in memory. Nothing of this one is
    locked afterwards."""
    may = _lock_memory()
    ctypes.CDLL(None).munlockall()
    return may


def run_like_others() -> None:
    """A child of a process that runs first does not, until it asks for it."""
    if runs_first():
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@contextlib.contextmanager
def run_as_before() -> Iterator[None]:
    """Around what changes how threads are run: this one, and those that begin in the block, are run
    as this one was."""
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
        with contextlib.suppress(ProcessLookupError):  # it has ended
            os.sched_setscheduler(thread, policy, parameters)


def _give_way(number: int, frame: FrameType | None) -> None:
    """Take SIGXCPU: a thread has computed for ``SPELL_S``. Every thread becomes ordinary."""
    global _spent
    _spent = True
    _schedule(_threads(), os.SCHED_OTHER, os.sched_param(0))
    with contextlib.suppress(OSError, ValueError):  # a closed stderr
        print(f"process {os.getpid()} does not run first any more: {scheduling()}", file=sys.stderr, flush=True)


def _lock_memory() -> bool:
    """Keep what is in memory there, and what comes to it; whether that was granted. Nothing is
    brought there in advance: the stacks of a dozen threads would be 100 MB."""
    return bool(ctypes.CDLL(None).mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) == 0)
