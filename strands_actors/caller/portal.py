"""The caller's one thread: a trio loop with a node and a mesh, shared by every robot of the
process.

It is a daemon thread: when the script ends, by whatever cause, nothing here keeps the process (or a
lease) alive, and the trees see their caller's end and make the robots safe.
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

from .descriptors import FOR_LOOP, FOR_ROBOT, require
from .nodes import Entrance, open_node
from .run_directory import run_dir

T = TypeVar("T")

LEAVE_S = 2.0
"""How long the end of a script waits for the loop at most. The loop ends within 10 ms on an idle
machine. A thread of it that still calls zenoh while Python ends would abort the process
(``kernel/channels/zenoh_exit.py``)."""
SWITCH_S = 0.0001
"""How long a thread that computes may keep the interpreter's lock from the loop, which lets go of
it at each of its system calls and wants it back. With Python's own 5 ms a setpoint beside a policy
that computes was 23 ms off its time (p99), a stop 12 ms late; with this 3 and 3. Two threads that
both compute pay for it: 5 to 10 % (measured)."""

_callers = itertools.count(1)


class Portal:
    """Runs async functions in the loop, from any thread."""

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
        """Start ``function(*args)`` in the loop; its result as a future of any thread. To cancel
        the future is to cancel what runs."""
        future: Future[T] = Future()
        scope = trio.CancelScope()

        async def run() -> None:
            try:
                with scope:
                    try:
                        result = await function(*args)
                    except Exception as error:  # the caller's to handle, not the loop's
                        if future.set_running_or_notify_cancel():
                            future.set_exception(error)
                    else:
                        if future.set_running_or_notify_cancel():
                            future.set_result(result)
            finally:
                future.cancel()  # the loop ends: nobody waits for it for ever

        def cancel(done: Future[T]) -> None:
            if done.cancelled():
                with contextlib.suppress(trio.RunFinishedError):
                    self._token.run_sync_soon(scope.cancel)

        def start() -> None:
            try:
                self.nursery.start_soon(run)
            except RuntimeError:  # the loop ends: its nursery is closed
                future.cancel()

        future.add_done_callback(cancel)
        try:
            self._token.run_sync_soon(start)
        except trio.RunFinishedError:
            future.cancel()
        return future

    def leave(self) -> None:
        """End the loop, from another thread. One that is busy is left behind."""
        with contextlib.suppress(trio.RunFinishedError):
            self._token.run_sync_soon(self._scope.cancel)
        self._thread.join(LEAVE_S)

    def call(self, function: Callable[..., Awaitable[T]], *args: Any) -> T:
        """Run ``function(*args)`` in the loop and wait for it, from any other thread."""
        return self.submit(function, *args).result()


@contextlib.asynccontextmanager
async def open_caller() -> AsyncIterator[tuple[Node, trio.Nursery, Entrance]]:
    """A node with a mesh for a process that starts robots. Raise ``OSError`` when too few files
    may be opened for it and a robot."""
    require(FOR_LOOP + FOR_ROBOT)
    number = next(_callers)  # a program may have several, in one loop or in many
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
    """This process was forked from one that runs robots."""


def forked_from() -> int:
    """Return the process that has the portal, in a child that was forked from it; else 0."""
    return _portal_pid if _portal is not None and _portal_pid != os.getpid() else 0


def portal() -> Portal:
    """This process's portal, started at first use. Raise ``Forked`` in a child of a process that has
    one: the threads of its sessions were not forked, and another session would wait for them for
    ever."""
    global _portal, _portal_pid
    parent = forked_from()
    if parent:
        why = f"this process was forked from process {parent}, which runs robots"
        raise Forked(f"{why}. call it there, or start this process by spawn instead of fork")
    with _lock:
        if _portal is None:
            _portal, _portal_pid = Portal(), os.getpid()
            atexit.register(_leave_quickly, _portal, os.getpid())
        return _portal


def _leave_quickly(shared: Portal, pid: int) -> None:
    """At the end of the script. The robots wait for our end: the interpreter's last collections,
    which would walk everything that was ever imported, are spared (38 ms to 9 ms measured)."""
    gc.freeze()
    if os.getpid() == pid:
        shared.leave()
        path = shared.entrance.endpoint.partition("/")[2]
        for leftover in (path, f"{path}.lock"):
            with contextlib.suppress(FileNotFoundError):
                os.unlink(leftover)
