"""Keep threads out of Python while the interpreter ends.

CPython before 3.14 ends a thread that asks for the interpreter's lock after finalization has begun:
it calls ``pthread_exit``, which unwinds the thread's stack. Frames of Rust cannot be unwound. The C
library then prints "FATAL: exception not rethrown" and aborts the process (exit code 134).

Two kinds of threads have frames of zenoh's on their stack and ask for the lock:

* a thread of zenoh's own, which runs one of our callbacks or drops one;
* a thread of Python's which is inside a call of zenoh's (a daemon thread that sends actions).

So the end of a script has three steps, in ``leave``: no other thread begins a call of zenoh's any
more, every session is closed, and the main thread waits until all calls have returned and zenoh has
dropped every callback. After that no such thread can ask for the lock.
"""

from __future__ import annotations

import atexit
import os
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Any, Protocol

import zenoh

LEAVE_S = 5.0
"""The longest time that the end of a script waits for zenoh. Sessions close within milliseconds on an idle
machine, and within ``zenoh_session.LEASE_MS`` when a peer is frozen.
"""
LOOK_S = 0.001


class Session(Protocol):
    """A session that can be closed from any thread, more than once."""

    def close(self) -> None: ...


class _Calls:
    """Counts the calls into zenoh that have not returned yet: ``with calls: publisher.put(data)``."""

    def __init__(self) -> None:
        self.under_way: deque[None] = deque()
        """One entry for each call. Appending and popping are atomic, adding to a number is not."""
        self.leaving_thread = 0
        self._parked = threading.Lock()
        self._parked.acquire()

    def __enter__(self) -> None:
        self.under_way.append(None)
        # Check this after the append. Then ``leave`` waits for a thread that has not noticed the end of the
        # script.
        if self.leaving_thread and self.leaving_thread != threading.get_ident():
            self.under_way.pop()
            # Wait for ever, since the process is ending.
            self._parked.acquire()

    def __exit__(
        self, error_type: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.under_way.pop()


calls = _Calls()
_open: dict[Session, int] = {}
_callbacks: dict[int, weakref.ref[Callable[[Any], None]]] = {}
"""The callbacks that zenoh has not dropped yet. The key is the identity of the reference, since two bound
methods of one object compare equal.
"""


def callback(function: Callable[[Any], None]) -> Any:
    """Return a handler for zenoh which calls ``function`` on zenoh's own thread.

    Args:
        function: Called with each sample or reply. It must return quickly and raise nothing.
    """
    reference = weakref.ref(function, lambda dropped: _callbacks.pop(id(dropped), None))
    _callbacks[id(reference)] = reference
    return zenoh.handlers.Callback(function, indirect=False)


def open_session(config: zenoh.Config) -> zenoh.Session:
    """Open a session, from any thread. Raise ``zenoh.ZError``."""
    with calls:
        return zenoh.open(config)


def opened(session: Session) -> None:
    """Register a session, so that it is closed at the end of the script if it is still open."""
    _open[session] = os.getpid()


def closed(session: Session) -> None:
    """Forget a session that has been closed."""
    _open.pop(session, None)


@atexit.register
def leave() -> None:
    """Close every session of this process, and return when no thread of zenoh's can enter Python.

    A forked child does nothing: it has the sessions without their threads.
    """
    calls.leaving_thread = threading.get_ident()
    for session, pid in list(_open.items()):
        if pid == os.getpid():
            session.close()
    until_s = time.monotonic() + LEAVE_S
    while (calls.under_way or _callbacks) and time.monotonic() < until_s:
        time.sleep(LOOK_S)


def _forget_in_child() -> None:
    """Clear the counts in a forked child. Only the forking thread exists there, and it is not in a call into
    zenoh.
    """
    calls.under_way.clear()
    _callbacks.clear()


os.register_at_fork(after_in_child=_forget_in_child)
