"""Start, watch and signal simulated processes, in place of the kernel and the system."""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any

import trio

from strands_actors.kernel.channels.permissions import Channel
from strands_actors.kernel.health.processor import Life, ProcessorUse
from strands_actors.kernel.node import Node
from strands_actors.kernel.processes.process import ChildProcess

from .links import SimLink, Socket, socket_pair
from .world import Process, World

Main = Callable[[dict[str, Any], Socket], Awaitable[None]]

FORKED_S = 0.008
EXECUTED_S = 0.25
"""Longest time from a start to the child's first step [assumed: a quiet machine]."""


class SimChild(ChildProcess):
    """The parent's view of a child and the link to it."""

    def __init__(self, child: Process, sock: Socket) -> None:
        super().__init__(child.pid, sock)  # type: ignore[arg-type]
        self._child = child
        self._sock = sock

    @property
    def alive(self) -> bool:
        return not self._child.gone

    def kill(self, sig: int = 9) -> None:
        if not self._sock.process.dead:
            self._child.kill(-sig)

    def pidfds(self) -> tuple[int, ...]:
        self._sock.process.resources.open_file()
        return (os.memfd_create(f"pidfd {self.pid}"),)

    async def wait(self) -> int:
        await until_ended(self._child)
        return self._child.code or 0

    def link(self, node: Node, channel: Channel | None = None) -> SimLink:  # type: ignore[override]
        self._linked = True
        return SimLink(node, self._sock, channel=channel)


async def until_ended(process: Process) -> None:
    """Wait until the system has reported the end of a process."""
    watcher = process.world.current
    ended = trio.Event()
    if process.gone:
        await trio.lowlevel.checkpoint()
        return
    process.at_end.append(lambda: watcher.post(ended.set))
    await ended.wait()


class Starter:
    """Starts children by the name of their entry."""

    def __init__(self, world: World, entries: Mapping[str, tuple[str, Main]]) -> None:
        self.world = world
        self.spawner_slow_s = 0.0
        self._entries = entries
        self._rng = world.rng("starts")

    def start(
        self, entry: str, args: Mapping[str, Any], most_s: float, descriptors: Sequence[int] = ()
    ) -> SimChild:
        role, main = self._entries[entry]
        parent = self.world.current
        parent.resources.open_file()
        boot_s = most_s * (0.3 + 0.7 * self._rng.random())
        ends: list[Socket] = []
        if descriptors:
            args = {**args, "descriptors": [os.dup(fd) for fd in descriptors]}

        async def run(process: Process) -> None:
            await trio.sleep(boot_s)
            await main(dict(args), ends[0])

        child = self.world.start(role, run, parent)
        ends.extend(socket_pair(child, parent))
        return SimChild(child, ends[1])

    def execute(
        self, entry: str, args: Mapping[str, Any], pass_fds: Sequence[int] = (), label: str = ""
    ) -> SimChild:
        """Start a child, as ``process.start`` does."""
        return self.start(entry, args, EXECUTED_S)


class SimAhead:
    """Replaces ``ForkedAhead``: one child that was forked in advance."""

    def __init__(self, starter: Starter) -> None:
        self._starter: Starter | None = starter

    def start(self, entry: str, args: Mapping[str, Any], descriptors: Sequence[int] = ()) -> SimChild | None:
        starter, self._starter = self._starter, None
        return None if starter is None else starter.start(entry, args, FORKED_S, descriptors)


class SimSpawner:
    """Replaces the root's ``Spawner``. A slow spawner starts its children late."""

    def __init__(self, starter: Starter) -> None:
        self._starter = starter
        self.pid = 1

    async def start(
        self, entry: str, args: Mapping[str, Any], session: bool = False, descriptors: Sequence[int] = ()
    ) -> SimChild:
        await trio.sleep(0.002)
        if self._starter.spawner_slow_s:
            await trio.sleep(self._starter.spawner_slow_s)
        return self._starter.start(entry, args, FORKED_S, descriptors)

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        task_status.started()
        await trio.sleep_forever()


class SimPeer:
    """Replaces ``Peer``: a process of the tree that is not a child of this one."""

    def __init__(self, world: World, pid: int, pidfd: int | None = None) -> None:
        found = world.by_pid(pid)
        assert found is not None
        self.pid = pid
        self._process = found
        self._pidfd = pidfd

    @property
    def ended(self) -> bool:
        return self._process.gone

    async def wait(self) -> None:
        await until_ended(self._process)

    async def fence(self, within_s: float) -> bool:
        self._process.kill()
        with trio.move_on_after(within_s):
            await self.wait()
        return self.ended

    def close(self) -> None:
        if self._pidfd is not None:
            os.close(self._pidfd)
            self._pidfd = None


class SimOs:
    """The ``os`` of the modules that run in a simulated process."""

    def __init__(self, world: World) -> None:
        self._world = world

    def getpid(self) -> int:
        return self._world.current.pid

    def getppid(self) -> int:
        parent = self._world.current.parent
        return 1 if parent is None or parent.gone else parent.pid

    def dup(self, fd: int) -> int:
        self._world.current.resources.open_file()
        return os.dup(fd)

    def pidfd_open(self, pid: int) -> int:
        """Return a descriptor to pass on. The receiver uses only the pid that is sent with it."""
        self._world.current.resources.open_file()
        return os.memfd_create(f"pidfd {pid}")

    def urandom(self, size: int) -> bytes:
        return self._world.rng("urandom").randbytes(size)

    def _exit(self, code: int) -> None:
        self._world.current.exit(code)

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)


def suspected(world: World, pid: int) -> ProcessorUse | None:
    """Return whether a process runs, is stopped or waits for a processor. A process with a lag waits."""
    process = world.by_pid(pid)
    if process is None or process.gone:
        return None
    if process.frozen:
        return ProcessorUse(0, 0, False, stopped=True)
    waited_ns = round((world.now_s if process.lag_s else 0.0) * 1e9)
    return ProcessorUse(0, waited_ns, bool(process.lag_s))


class SimStatFile:
    """Replaces ``StatFile``."""

    def __init__(self, world: World, pid: int) -> None:
        self._world = world
        self._pid = pid

    def life(self) -> Life:
        return life_of(self._world, self._pid)


def life_of(world: World, pid: int) -> Life:
    process = world.by_pid(pid)
    return Life() if process is None or process.gone else Life(process.frozen, process.dead)
