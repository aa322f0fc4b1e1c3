"""Does the caller still answer? Its lease is beaten accordingly.

A heartbeat that came from a thread alone would prove nothing: such a thread outlives a main thread
that has crashed, and runs happily beside one that spins. So a heartbeat says two things. The
process lives: its main thread has not ended. And the thread that last commanded the robot answers:
it waits (sleeps, reads, sits in a prompt) or has called us since the last beat. A target that was
latched lives only as long as both are true: who only computes, without a call, for as long as the
lease lasts, no longer looks after its robot, which then holds still; the next command simply takes
it up again. A rollout looks after itself: its setpoints expire, and heavy work beside it does not
end it.
"""

from __future__ import annotations

import os
import threading
import time

from strands_actors.kernel.clock import NS
from strands_actors.kernel.health.processor import standing

BUSY_SHARE = 0.5
"""Of the time between two beats spent computing; a thread that polls with short sleeps stays
below."""


class Liveness:
    """Call ``enter`` and ``leave`` around each verb, or say ``with``; ``look`` at each
    heartbeat."""

    def __init__(self) -> None:
        self._thread = threading.current_thread()
        self._calls = 0
        self._seen_calls = 0
        self._busy_ns = 0
        self._at_ns = time.monotonic_ns()
        self._inside = 0
        self._called_ns = self._at_ns

    def enter(self) -> None:
        """The present thread calls a verb."""
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
        """(the process lives, seconds since the commanding thread answered; -1.0: not since the
        last look)."""
        if not threading.main_thread().is_alive():
            return False, -1.0
        thread = self._thread if self._thread.is_alive() else threading.main_thread()
        now_ns = time.monotonic_ns()
        busy_ns = _computed_ns(thread)
        computed_ns, passed_ns = busy_ns - self._busy_ns, now_ns - self._at_ns
        called = self._calls != self._seen_calls
        self._busy_ns, self._at_ns, self._seen_calls = busy_ns, now_ns, self._calls
        if computed_ns < BUSY_SHARE * passed_ns:
            return True, computed_ns / NS  # it may have begun to spin, but no longer ago than that
        if self._inside > 0:
            return True, 0.0
        return True, (now_ns - self._called_ns) / NS if called else -1.0


def _computed_ns(thread: threading.Thread) -> int:
    """Return how long a thread has computed, or could not: it waited for a processor, or we did,
    who may have had the interpreter's lock meanwhile. 0 where the system does not tell (macOS).
    Without the waits, a thread that spins on a busy machine would look as if it slept."""
    # in a forked process, native_id of the main thread is still that of before the fork (CPython
    # 3.11)
    number = None if thread is threading.main_thread() else thread.native_id
    theirs, ours = standing(os.getpid(), number), standing(os.getpid(), threading.get_native_id())
    if theirs is None or ours is None:
        return 0
    return theirs.computed_ns + theirs.waited_ns + ours.waited_ns
