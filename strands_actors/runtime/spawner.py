"""Starting a process while something else must not wait.

Whoever starts a process stands still, with the interpreter's lock held, until the child has begun: a few
milliseconds, but a tenth of a second on a busy machine, in which a root that does not beat looks frozen to its
wire. So the root has a small process start others for it: forked while the root has one thread and no session,
it does nothing else, and ends with its root. What it starts it forks: all that a child of the tree imports is
there already, which is a quarter of a second of computing.
"""

from __future__ import annotations

import contextlib
import gc
import os
import select
import signal
import socket
import struct
from collections.abc import Mapping
from typing import Any

import trio

from .forked import fork_child
from .process import ChildProcess, specify, wait_for_end_of

_REPORT = struct.Struct("<ii")  # pid, and _STARTED or the exit code
_STARTED = 1 << 30
_CODE_S = 0.5


class SpawnedChild(ChildProcess):
    """A child of the spawner's. Its exit code comes from there."""

    def __init__(self, pid: int, link_socket: socket.socket) -> None:
        super().__init__(pid, link_socket)
        self.code: int | None = None
        self._coded = trio.Event()

    @property
    def alive(self) -> bool:
        return self.code is None

    def kill(self, sig: int = signal.SIGKILL) -> None:
        if self.code is None:
            with contextlib.suppress(ProcessLookupError):  # gone; its exit code is on the way
                os.kill(self.pid, sig)

    async def wait(self) -> int:
        if self.code is None:
            await wait_for_end_of(self.pid)
            with trio.move_on_after(_CODE_S):  # a spawner that is gone tells none
                await self._coded.wait()
        return self.code or 0

    def ended(self, code: int) -> None:
        self.code = code
        self._coded.set()


class Spawner:
    """Make it before there are threads, run ``run``, then ``start``."""

    def __init__(self, close: tuple[int, ...] = ()) -> None:
        """``close``: descriptors that are not for the spawner to keep open."""
        self._socket, theirs = socket.socketpair()
        if os.fork() == 0:
            try:
                self._socket.close()
                for fd in close:
                    os.close(fd)
                _serve(theirs)
            finally:
                os._exit(0)
        theirs.close()
        self._socket.setblocking(False)
        self._children: dict[int, SpawnedChild] = {}
        self._links: list[socket.socket] = []
        self._sender, self._receiver = trio.open_memory_channel[SpawnedChild](1)
        self._one_at_a_time = trio.Lock()

    async def start(self, entry: str, args: Mapping[str, Any]) -> ChildProcess:
        """As ``process.start``, without standing still. Raise ``OSError`` when the spawner is gone."""
        async with self._one_at_a_time:
            ours, theirs = socket.socketpair()
            with theirs:
                self._links.append(ours)
                socket.send_fds(self._socket, [b"!"], [theirs.fileno()])
            child = await self._receiver.receive()
        specify(ours, entry, args)
        return child

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Hear what the spawner reports; ends with it."""
        task_status.started()
        buffer = b""
        while True:
            await trio.lowlevel.wait_readable(self._socket)
            data = self._socket.recv(1024)
            if not data:
                return
            buffer += data
            while len(buffer) >= _REPORT.size:
                pid, what = _REPORT.unpack_from(buffer)
                buffer = buffer[_REPORT.size :]
                if what == _STARTED:
                    self._children[pid] = SpawnedChild(pid, self._links.pop(0))
                    self._sender.send_nowait(self._children[pid])
                elif pid in self._children:
                    self._children.pop(pid).ended(what)


def _serve(sock: socket.socket) -> None:
    """The spawner process: one request, one child; then report its end."""
    gc.collect()
    gc.freeze()  # a child's own collection then neither walks nor copies what it was born with (6 ms)
    children: dict[int, int] = {}
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
            pid = fork_child(descriptors[0])
            os.close(descriptors[0])
            children[os.pidfd_open(pid)] = pid
            sock.sendall(_REPORT.pack(pid, _STARTED))
