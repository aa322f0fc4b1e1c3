"""A process that runs before everything else: SCHED_FIFO, where the system permits it.

For wires that are spoken to 500 times a second: on a busy machine an ordinary process waits 28 ms
for its turn now and then, one of these 0.15 ms. It needs a second core, since one that spins keeps
the core it is on.
"""

from __future__ import annotations

import contextlib
import os

STANDBY_PRIORITY = 13
"""Above both, which it has to be able to end. It does next to nothing as long as one of them
lives."""
ROOT_PRIORITY = 12
WIRE_PRIORITY = 11
"""Below the root, which has to be able to end it."""
TWIN_PRIORITY = 10
"""The robot has a computer of its own."""


def run_first(priority: int) -> None:
    """Ask for it; ``scheduling`` says whether it was granted."""
    if hasattr(os, "sched_setscheduler") and len(os.sched_getaffinity(0)) > 1:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def runs_first() -> bool:
    """Of the calling thread."""
    return hasattr(os, "sched_getscheduler") and os.sched_getscheduler(0) == os.SCHED_FIFO


def scheduling() -> str:
    """How this process is run, for people."""
    if not hasattr(os, "sched_getscheduler"):
        return "ordinary: this system has no SCHED_FIFO"
    if runs_first():
        return f"SCHED_FIFO {os.sched_getparam(0).sched_priority}"
    if len(os.sched_getaffinity(0)) < 2:
        return "ordinary: SCHED_FIFO needs a second core"
    return f"ordinary: SCHED_FIFO was not granted. Allow it with: ulimit -r {STANDBY_PRIORITY}"


def run_like_others() -> None:
    """A child of a process that runs first does not, until it asks for it."""
    if runs_first():
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
