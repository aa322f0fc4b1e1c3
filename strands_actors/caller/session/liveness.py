"""Decide whether the caller's program still answers. The heartbeats of its lease depend on it.

A heartbeat from a background thread alone would prove nothing: the thread survives a crash of the main
thread, and runs on while the main thread spins. So a heartbeat carries two facts:

    the process is alive    its main thread has not ended
    the program answers     the thread that last commanded the robot waits (sleep, read, prompt), or has
                            called a verb since the last heartbeat

A latched target (in force until the next one) is kept only while both are true. If the commanding thread only
computes for the duration of the lease, without a call, the robot holds; the next command moves it again. A
rollout needs only the first fact: its setpoints expire by themselves, and heavy work in the program must not
end it.
"""

from __future__ import annotations

import os
import threading
import time

from strands_actors.kernel.clock import NS
from strands_actors.kernel.health.processor import processor_use

BUSY_SHARE = 0.5
"""A thread that computes for this share of the time between two heartbeats counts as busy. A thread that
polls with short sleeps stays below it."""


class Liveness:
    """Measures whether the program is alive and answers.

    Call ``enter`` and ``leave`` around each verb (or use ``with``), and ``look`` at each heartbeat.
    """

    def __init__(self) -> None:
        self._thread = threading.current_thread()
        self._calls = 0
        self._counted_calls = 0
        self._busy_ns = 0
        self._at_ns = time.monotonic_ns()
        self._inside = 0
        self._called_ns = self._at_ns

    def enter(self) -> None:
        """Note that the present thread calls a verb."""
        self._thread = threading.current_thread()
        self._calls += 1
        self._inside += 1

    def leave(self) -> None:
        self._inside -= 1
        self._called_ns = time.monotonic_ns()

    def __enter__(self) -> None:
        self.enter()

    def __exit__(self, *_: object) -> None:
        self.leave()

    def look(self) -> tuple[bool, float]:
        """Return the two facts of a heartbeat.

        Returns:
            First, True if the process is alive. Second, the seconds since the commanding thread last answered.
            It is -1.0 if the thread has not answered since the last call of ``look``.
        """
        if not threading.main_thread().is_alive():
            return False, -1.0
        thread = self._thread if self._thread.is_alive() else threading.main_thread()
        now_ns = time.monotonic_ns()
        busy_ns = _computed_ns(thread)
        computed_ns, passed_ns = busy_ns - self._busy_ns, now_ns - self._at_ns
        called = self._calls != self._counted_calls
        self._busy_ns, self._at_ns, self._counted_calls = busy_ns, now_ns, self._calls
        if computed_ns < BUSY_SHARE * passed_ns:
            # The thread may have begun to spin since the last call of ``look``. This moment is not longer ago than
            # the time that the thread has computed since.
            return True, computed_ns / NS
        if self._inside > 0:
            return True, 0.0
        return True, (now_ns - self._called_ns) / NS if called else -1.0


def _computed_ns(thread: threading.Thread) -> int:
    """Return the time in which a thread computed, or waited for a processor.

    The waits of the present thread count, too, since it may have kept the interpreter's lock meanwhile. Without
    these waits a spinning thread on a busy computer would seem to sleep. The result is 0 on systems that do not
    report this (macOS).
    """
    # In a forked process, ``native_id`` of the main thread is still the id from before the fork (CPython
    # 3.11).
    number = None if thread is threading.main_thread() else thread.native_id
    theirs, ours = processor_use(os.getpid(), number), processor_use(os.getpid(), threading.get_native_id())
    if theirs is None or ours is None:
        return 0
    return theirs.computed_ns + theirs.waited_ns + ours.waited_ns
