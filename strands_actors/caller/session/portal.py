"""The background thread of a program: a trio loop with a node (the actors of this process) and a mesh (the
connections to the robots).

All robots of the program share it. It is a daemon thread. When the script ends for any reason, the thread keeps
neither the process alive nor its right to command. The robots' processes notice the end of the script and make
the robots safe.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import itertools
import os
import secrets
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import Future
from typing import Any, TypeVar

import trio

from strands_actors.kernel.channels.zenoh_mesh import unix_endpoint
from strands_actors.kernel.node import Node

from ..processes.descriptors import FOR_LOOP, FOR_ROBOT, require
from ..processes.nodes import Entrance, open_node
from ..processes.run_directory import run_dir

T = TypeVar("T")

LEAVE_S = 2.0
"""Longest wait for the loop at the end of a script. On an idle computer the loop ends within 10 ms. A thread
of the loop that calls zenoh while Python ends would abort the process
(``kernel/channels/zenoh_exit.py``)."""
SWITCH_S = 0.0001
"""How long a computing thread may keep the interpreter's lock while the loop waits for it. The loop releases
the lock at each system call and needs it again afterwards. With Python's default of 5 ms, while a policy
computed, setpoints were 23 ms off their time (p99) and a stop was 12 ms late; with this value 3 ms and
3 ms. Two threads that both compute lose 5 to 10 % by it (measured)."""

_callers = itertools.count(1)


class Portal:
    """The background thread's loop. Any thread may run async functions in it."""

    def __init__(self) -> None:
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_S))
        self._ready: Future[None] = Future()
        self._thread = threading.Thread(target=self._main, name="strands-actors", daemon=True)
        self._thread.start()
        self._ready.result()

    def _main(self) -> None:
        try:
            trio.run(self._serve)
        except BaseException as error:
            if self._ready.done():
                raise
            self._ready.set_exception(error)

    async def _serve(self) -> None:
        self._token = trio.lowlevel.current_trio_token()
        with trio.CancelScope() as self._scope:
            async with open_caller() as (node, nursery, entrance):
                self.node, self.nursery, self.entrance = node, nursery, entrance
                self._ready.set_result(None)
                await trio.sleep_forever()

    def submit(self, function: Callable[..., Awaitable[T]], *args: Any) -> Future[T]:
        """Start ``function(*args)`` in the loop, and return its future. Any thread may call it.

        If the future is cancelled, the function is cancelled, too.
        """
        future: Future[T] = Future()
        scope = trio.CancelScope()

        async def run() -> None:
            try:
                with scope:
                    try:
                        result = await function(*args)
                    except Exception as error:
                        # The caller of ``submit`` handles the exception, not the loop.
                        if future.set_running_or_notify_cancel():
                            future.set_exception(error)
                    else:
                        if future.set_running_or_notify_cancel():
                            future.set_result(result)
            finally:
                # If the loop ends first, this keeps a thread from waiting for ever.
                future.cancel()

        def cancel(done: Future[T]) -> None:
            if done.cancelled():
                with contextlib.suppress(trio.RunFinishedError):
                    self._token.run_sync_soon(scope.cancel)

        def start() -> None:
            try:
                self.nursery.start_soon(run)
            except RuntimeError:  # The loop is ending, and its nursery is closed.
                future.cancel()

        future.add_done_callback(cancel)
        try:
            self._token.run_sync_soon(start)
        except trio.RunFinishedError:
            future.cancel()
        return future

    def leave(self) -> None:
        """End the loop, from another thread. If the loop is busy, do not wait for its end."""
        with contextlib.suppress(trio.RunFinishedError):
            self._token.run_sync_soon(self._scope.cancel)
        self._thread.join(LEAVE_S)

    def call(self, function: Callable[..., Awaitable[T]], *args: Any) -> T:
        """Run ``function(*args)`` in the loop and wait for it, from any other thread."""
        return self.submit(function, *args).result()


@contextlib.asynccontextmanager
async def open_caller() -> AsyncIterator[tuple[Node, trio.Nursery, Entrance]]:
    """Open a node (the actors of this process) that other processes can connect to, for a process that starts
    robots. Raise ``OSError`` if the system allows too few open files."""
    require(FOR_LOOP + FOR_ROBOT)
    # A program may have several nodes, in one loop or in several, so number them.
    number = next(_callers)
    path = f"{run_dir()}/caller-{os.getpid()}-{number}.sock"
    entrance = Entrance(unix_endpoint(path), secrets.token_hex(16))
    listens = open_node(f"caller.{os.getpid()}.{number}", [entrance.endpoint], secret=entrance.secret)
    try:
        async with listens as (node, nursery):
            yield node, nursery, entrance
    finally:
        for leftover in (path, f"{path}.lock"):
            with contextlib.suppress(FileNotFoundError):
                os.unlink(leftover)


_portal: Portal | None = None
_portal_pid = 0
_lock = threading.Lock()


class Forked(OSError):
    """This process was forked from one that runs robots, so it cannot use them."""


def forked_from() -> int:
    """Return the process id of the parent with the portal, in a forked child; otherwise 0."""
    return _portal_pid if _portal is not None and _portal_pid != os.getpid() else 0


def portal() -> Portal:
    """Return the portal (the background thread) of this process. The first call starts it.

    Raises:
        Forked: A parent of this process has a portal. A fork does not copy the threads of its zenoh sessions,
            so another session would wait for these threads for ever.
    """
    global _portal, _portal_pid
    parent = forked_from()
    if parent:
        reason = f"this process was forked from process {parent}, which runs robots"
        raise Forked(f"{reason}. Call it there, or start this process by spawn instead of fork")
    with _lock:
        if _portal is None:
            _portal, _portal_pid = Portal(), os.getpid()
            atexit.register(_leave_quickly, _portal, os.getpid())
        return _portal


def _leave_quickly(shared: Portal, pid: int) -> None:
    """End the loop at the end of the script, and remove its socket.

    The robots wait for the end of this process. So the interpreter's last garbage collections, which walk
    all imported objects, are skipped (measured: 9 ms instead of 38 ms).
    """
    gc.freeze()
    if os.getpid() == pid:
        shared.leave()
        path = shared.entrance.endpoint.partition("/")[2]
        for leftover in (path, f"{path}.lock"):
            with contextlib.suppress(FileNotFoundError):
                os.unlink(leftover)
