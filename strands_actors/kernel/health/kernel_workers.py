"""Give real-time priority to the kernel's workers, which deliver data of serial ports.

The workers are ordinary threads (``kworker/u...``). On a busy computer a worker waits for its turn. Every
process that reads the port, or that asks for the number of waiting bytes, then waits too, whatever its own
priority. With eight busy loops and an installation of packages, waits of 70 ms were measured, 300 ms in all.
That looks like a robot that does not answer. A pty needs the workers in both directions, a USB adapter for
received data. Network connections do not need them.

Only a process with CAP_SYS_NICE (root, or a service that is given it) can raise their priority. They stay below
the processes that keep a robot safe.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import trio

from .realtime import KERNEL_PRIORITY, runs_first

LOOK_S = 1.0
"""Seconds between two searches. The kernel starts new workers when the present ones wait."""
_PROC = Path("/proc")
_NAME = "kworker/u"
"""The name of workers that belong to no processor. Source: workqueue.rst of the kernel's documentation."""


def _threads() -> set[int]:
    """Return all threads of the kernel. Process 2 starts them. Source: proc(5), kthreadd."""
    try:
        return set(map(int, (_PROC / "2/task/2/children").read_text().split()))
    except OSError:  # a container does not show them
        return set()


async def keep_them_early() -> None:
    """Raise the priority of present and new workers until cancelled.

    Return at once where that is not permitted, and in a process without real-time priority.
    """
    previous = set[int]()
    while runs_first():
        threads = _threads()
        for thread in threads - previous:
            with contextlib.suppress(ProcessLookupError, FileNotFoundError):  # the thread has ended
                if not (_PROC / str(thread) / "comm").read_text().startswith(_NAME):
                    continue
                try:
                    os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(KERNEL_PRIORITY))
                except PermissionError:
                    return
        previous = threads
        await trio.sleep(LOOK_S)
