"""The kernel's own workers, which hand on what a serial port has received.

They are ordinary threads (``kworker/u...``): beside busy programs each waits for its turn as those
do, and with it every process that reads the port, or asks whether there is anything to read,
however early that one runs. Beside eight busy loops and an installation of packages 70 ms were
measured at a time, 300 in all; that looks like a robot that does not answer. A pty needs them both
ways, an adapter on USB for what it receives. Network connections do without.

Only who may (CAP_SYS_NICE: root, or a service that is given it) can have them run before ordinary
programs. They stay behind what keeps a robot safe.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import trio

from .realtime import KERNEL_PRIORITY, runs_first

LOOK_S = 1.0
"""The kernel starts new ones when those that are there wait."""
_PROC = Path("/proc")
_NAME = "kworker/u"
"""Of those that belong to no processor. Source: workqueue.rst of the kernel's documentation."""


def _threads() -> set[int]:
    """Return all threads of the kernel: process 2 starts them. Source: proc(5), kthreadd."""
    try:
        return set(map(int, (_PROC / "2/task/2/children").read_text().split()))
    except OSError:  # a container does not show them
        return set()


async def keep_them_early() -> None:
    """Look for new ones as long as this runs. Return at once where that is not permitted, and in a
    process that does not run first itself."""
    known = set[int]()
    while runs_first():
        threads = _threads()
        for thread in threads - known:
            with contextlib.suppress(ProcessLookupError, FileNotFoundError):  # it has ended
                if not (_PROC / str(thread) / "comm").read_text().startswith(_NAME):
                    continue
                try:
                    os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(KERNEL_PRIORITY))
                except PermissionError:
                    return
        known = threads
        await trio.sleep(LOOK_S)
