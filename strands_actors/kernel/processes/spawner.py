"""A fork server. It starts processes for the root process, which must not pause.

Theory. A process that starts another one is blocked, with the interpreter's lock held, until the child has
begun. That takes a few milliseconds, but a tenth of a second on a busy machine. Without heartbeats for so long,
a root looks frozen to its wire process. So the root lets a small process, the spawner, start others.

* The spawner is forked while the root has one thread and no session. It does nothing else, and ends with its
  root.
* It forks its children. A forked child has all imports already. A child that is started by exec needs a quarter
  of a second of computing for them.
* A spawner that is dead or does not answer is ended, and another one replaces it. The root has threads by then,
  so the new one is started by exec.
* A request without an answer is never carried out later, since its spawner has been killed.
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

from .fork import UNKNOWN, Forked, fork_child
from .identity import take_name
from .process import ChildProcess, OwnChild, specify, start

# A report has two numbers: the pid of a child, and its exit code or _STARTED (a pidfd comes with it). The first
# report has the spawner's own pid and _READY.
_REPORT = struct.Struct("<ii")
_STARTED, _READY = 1 << 30, 1 << 29
_GROUP, _SESSION = b"g", b"s"
"""The requests: a child that is a process group, or one that is a session."""
_CODE_S = 0.5
ANSWER_S = 1.0
"""Seconds to wait for a fork. It takes milliseconds, so a spawner that has not answered by then is frozen."""
READY_S = 5.0
"""Seconds to wait for the start of a new spawner: a quarter of a second of computing, on a busy machine."""


class SpawnedChild(ChildProcess):
    """A child of the spawner. The spawner reports the exit code of the child."""

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
            with trio.move_on_after(_CODE_S):
                await self._coded.wait()
            if self.code is None:
                self.ended(UNKNOWN)  # The spawner has ended, too, and the exit code is lost.
        assert self.code is not None
        return self.code

    def ended(self, code: int) -> None:
        self.code = code
        self._coded.set()


class _Server:
    """The connection of the root process to one spawner process."""

    def __init__(self, process: ChildProcess) -> None:
        self.process = process
        self._socket = process.socket
        self._socket.setblocking(False)
        self._children: dict[int, SpawnedChild] = {}
        self._request: tuple[socket.socket, trio.Event] | None = None
        self._answer: SpawnedChild | None = None
        self._ready = trio.Event()
        self.has_ended = False

    async def fork(self, session: bool) -> SpawnedChild | None:
        """Request a child. Return None if the spawner does not answer or has ended.

        Only one request may be made at a time.
        """
        with trio.move_on_after(READY_S):
            await self._ready.wait()
        ours, theirs = socket.socketpair()
        answered = trio.Event()
        self._request, self._answer = (ours, answered), None
        try:
            with theirs:
                socket.send_fds(self._socket, [_SESSION if session else _GROUP], [theirs.fileno()])
            with trio.move_on_after(ANSWER_S):
                await answered.wait()
        except OSError:
            # The spawner has ended.
            pass
        self._request = None
        if self._answer is None:
            ours.close()
        return self._answer

    async def hear(self) -> None:
        """Handle the spawner's messages (of new children, and of children that have ended). Return when the
        spawner has ended.
        """
        try:
            await self._hear()
        finally:
            self.has_ended = True
            self._ready.set()
            if self._request is not None:
                self._request[1].set()
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
                pid, code = _REPORT.unpack_from(buffer)
                buffer = buffer[_REPORT.size :]
                if code == _READY:
                    self._ready.set()
                elif code == _STARTED:
                    self._started(pid, pidfds.popleft())
                elif pid in self._children:
                    self._children.pop(pid).ended(code)

    def _started(self, pid: int, pidfd: int) -> None:
        # The root has given up this request and closed its link. So the child ends before it gets a
        # specification.
        if self._request is None:
            os.close(pidfd)
            return
        ours, answered = self._request
        self._children[pid] = self._answer = SpawnedChild(pid, ours, pidfd)
        answered.set()


class Spawner:
    """Starts processes through a spawner. Create it before there are threads, run ``run``, then call ``start``."""

    def __init__(
        self, close: tuple[int, ...] = (), name: Sequence[str] = (), forget: Callable[[], object] | None = None
    ) -> None:
        """Fork the spawner.

        Args:
            close: Descriptors that the spawner closes.
            name: Process name of the spawner, as arguments of ``take_name``.
            forget: Called in the spawner, so that its children do not inherit passwords and the paths of keys.
        """
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
        self._start_lock = trio.Lock()

    @property
    def pid(self) -> int:
        """Return the process id of the present spawner."""
        return self._server.process.pid

    async def start(
        self, entry: str, args: Mapping[str, Any], session: bool = False, descriptors: Sequence[int] = ()
    ) -> ChildProcess:
        """Start a child as ``process.start`` does, without blocking this process.

        Args:
            entry: ``module:function``.
            args: Arguments of that function.
            session: True: the child begins a new session of processes. False: only a new process group.
            descriptors: Open files for the child (``process.specify``).

        Raises:
            OSError: The spawner does not answer. Nothing was started, and nothing will be started later.
        """
        async with self._start_lock:
            if self._server.has_ended:
                self._replace()
            child = await self._server.fork(session)
            if child is None:
                reason = "the process that starts others " + (
                    "has ended" if self._server.has_ended else f"did not answer within {ANSWER_S:g} s"
                )
                # Kill the spawner, so that it starts nothing later.
                self._server.process.kill()
                self._replace()
                raise OSError(f"{reason}; it has been replaced")
        specify(child.socket, entry, args, descriptors)
        return child

    def _replace(self) -> None:
        self._server = _Server(start(f"{__name__}:main", {"name": self._name}))
        self._replaced.set()

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Handle the reports of the spawner, and of each one that replaces it."""
        task_status.started()
        async with trio.open_nursery() as nursery:
            while True:
                nursery.start_soon(self._server.hear)
                await self._replaced.wait()
                self._replaced = trio.Event()


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """The entry of a spawner that replaces another one."""
    _serve(sock, args["name"])


def _serve(sock: socket.socket, name: Sequence[str]) -> None:
    """Run the spawner: fork one child for each request, and report each end."""
    if name:
        take_name(*name)
    gc.collect()
    # Freeze the inherited objects. A collection in a child then neither walks nor copies them (6 ms).
    gc.freeze()
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
            # Open the pidfd before the child can be reaped. Until then its pid cannot be used again.
            pidfd = os.pidfd_open(pid)
            children[pidfd] = pid
            socket.send_fds(sock, [_REPORT.pack(pid, _STARTED)], [pidfd])
