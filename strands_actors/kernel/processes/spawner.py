"""Starting a process while something else must not wait.

Whoever starts a process stands still, with the interpreter's lock held, until the child has begun:
a few milliseconds, but a tenth of a second on a busy machine, in which a root that does not beat
looks frozen to its wire. So the root has a small process start others for it: forked while the root
has one thread and no session, it does nothing else, and ends with its root. What it starts it
forks: all that a child of the tree imports is there already, which is a quarter of a second of
computing.

One that is dead or does not answer is ended, and the next start is made by another, which has to be
executed: the root has threads by then. So nothing that was asked of it and not answered is done
later.
"""

from __future__ import annotations

import gc
import os
import select
import socket
import struct
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import trio

from .fork import Forked, fork_child
from .identity import take_name
from .process import ChildProcess, OwnChild, specify, start

_REPORT = struct.Struct("<ii")  # pid, and _STARTED (a pidfd comes with it) or the exit code; its own: _READY
_STARTED, _READY = 1 << 30, 1 << 29
_GROUP, _SESSION = b"g", b"s"
"""What is asked for: a child that is a process group of its own, or a session."""
_CODE_S = 0.5
ANSWER_S = 1.0
"""A fork takes milliseconds: a spawner that has not answered by then is frozen."""
READY_S = 5.0
"""For one that replaces another to begin: a quarter of a second of computing, on a busy machine."""


class SpawnedChild(ChildProcess):
    """A child of the spawner's. Its exit code comes from there."""

    def __init__(self, pid: int, link_socket: socket.socket, pidfd: int) -> None:
        super().__init__(pid, link_socket, pidfd)
        self.code: int | None = None
        self._coded = trio.Event()

    @property
    def alive(self) -> bool:
        return self.code is None

    async def wait(self) -> int:
        if self.code is None:
            await self._until_ended()
            with trio.move_on_after(_CODE_S):  # a spawner that is gone tells none
                await self._coded.wait()
        return self.code or 0

    def ended(self, code: int) -> None:
        self.code = code
        self._coded.set()


class _Server:
    """One spawner process, as its root has it."""

    def __init__(self, process: ChildProcess) -> None:
        self.process = process
        self._socket = process.socket
        self._socket.setblocking(False)
        self._children: dict[int, SpawnedChild] = {}
        self._asked: tuple[socket.socket, trio.Event] | None = None
        self._answer: SpawnedChild | None = None
        self._ready = trio.Event()
        self.gone = False

    async def fork(self, session: bool) -> SpawnedChild | None:
        """None when it does not answer, or is gone. One at a time."""
        with trio.move_on_after(READY_S):
            await self._ready.wait()
        ours, theirs = socket.socketpair()
        answered = trio.Event()
        self._asked, self._answer = (ours, answered), None
        try:
            with theirs:
                socket.send_fds(self._socket, [_SESSION if session else _GROUP], [theirs.fileno()])
            with trio.move_on_after(ANSWER_S):
                await answered.wait()
        except OSError:
            pass  # it is gone
        self._asked = None
        if self._answer is None:
            ours.close()
        return self._answer

    async def hear(self) -> None:
        """Take its reports; returns when it is gone."""
        try:
            await self._hear()
        finally:
            self.gone = True
            self._ready.set()
            if self._asked is not None:
                self._asked[1].set()
            self._socket.close()
        await self.process.wait()

    async def _hear(self) -> None:
        buffer, pidfds = b"", deque[int]()
        while True:
            await trio.lowlevel.wait_readable(self._socket)
            try:
                data, received, _, _ = socket.recv_fds(self._socket, 1024, 16)
            except BlockingIOError:
                continue
            except ConnectionError:
                return
            if not data:
                return
            pidfds.extend(received)
            buffer += data
            while len(buffer) >= _REPORT.size:
                pid, what = _REPORT.unpack_from(buffer)
                buffer = buffer[_REPORT.size :]
                if what == _READY:
                    self._ready.set()
                elif what == _STARTED:
                    self._started(pid, pidfds.popleft())
                elif pid in self._children:
                    self._children.pop(pid).ended(what)

    def _started(self, pid: int, pidfd: int) -> None:
        if self._asked is None:  # given up: its link is closed, so it ends before it is told what to run
            os.close(pidfd)
            return
        ours, answered = self._asked
        self._children[pid] = self._answer = SpawnedChild(pid, ours, pidfd)
        answered.set()


class Spawner:
    """Make it before there are threads, run ``run``, then ``start``."""

    def __init__(
        self, close: tuple[int, ...] = (), name: Sequence[str] = (), forget: Callable[[], object] | None = None
    ) -> None:
        """``close``: descriptors that are not for the spawner to keep open. ``name``: what it is
        called, for ``take_name``. ``forget``: called in it, so that what it starts is not born with
        passwords and the paths of keys."""
        self._name = tuple(name)
        ours, theirs = socket.socketpair()
        pid = os.fork()
        if pid == 0:
            try:
                ours.close()
                for fd in close:
                    os.close(fd)
                if forget is not None:
                    forget()
                _serve(theirs, name)
            finally:
                os._exit(0)
        theirs.close()
        self._server = _Server(OwnChild(Forked(pid), ours))
        self._replaced = trio.Event()
        self._one_at_a_time = trio.Lock()

    @property
    def pid(self) -> int:
        """Return the id of the process that starts others now."""
        return self._server.process.pid

    async def start(
        self, entry: str, args: Mapping[str, Any], session: bool = False, descriptors: Sequence[int] = ()
    ) -> ChildProcess:
        """As ``process.start``, without standing still; with ``session`` it is a session of its
        own. ``descriptors``: see ``process.specify``. Raise ``OSError`` when the spawner does not
        answer: then nothing was started, nor will be."""
        async with self._one_at_a_time:
            if self._server.gone:
                self._replace()
            child = await self._server.fork(session)
            if child is None:
                why = "the process that starts others " + (
                    "has ended" if self._server.gone else f"did not answer within {ANSWER_S:g} s"
                )
                self._server.process.kill()  # from now on it starts nothing
                self._replace()
                raise OSError(f"{why}; it has been replaced")
        specify(child.socket, entry, args, descriptors)
        return child

    def _replace(self) -> None:
        self._server = _Server(start(f"{__name__}:main", {"name": self._name}))
        self._replaced.set()

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Hear what the spawner reports, and each that replaces it."""
        task_status.started()
        async with trio.open_nursery() as nursery:
            while True:
                nursery.start_soon(self._server.hear)
                await self._replaced.wait()
                self._replaced = trio.Event()


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Entry of a spawner that replaces another."""
    _serve(sock, args["name"])


def _serve(sock: socket.socket, name: Sequence[str]) -> None:
    """The spawner process: one request, one child; then report its end."""
    if name:
        take_name(*name)
    gc.collect()
    gc.freeze()  # a child's own collection then neither walks nor copies what it was born with (6 ms)
    children: dict[int, int] = {}
    sock.sendall(_REPORT.pack(os.getpid(), _READY))
    while True:
        requests = sock.fileno()
        ready, _, _ = select.select([requests, *children], [], [])
        for pidfd in [fd for fd in ready if fd in children]:
            pid = children.pop(pidfd)
            os.close(pidfd)
            _, status = os.waitpid(pid, 0)
            sock.sendall(_REPORT.pack(pid, os.waitstatus_to_exitcode(status)))
        if requests in ready:
            data, descriptors, _, _ = socket.recv_fds(sock, 1, 1)
            if not data:
                return
            pid = fork_child(descriptors[0], session=data == _SESSION)
            os.close(descriptors[0])
            pidfd = os.pidfd_open(pid)  # before it can be reaped: nobody else can have its number
            children[pidfd] = pid
            socket.send_fds(sock, [_REPORT.pack(pid, _STARTED)], [pidfd])
