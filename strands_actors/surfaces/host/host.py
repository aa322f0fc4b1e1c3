"""The host: keep all robots of a file, obey orders, and tell systemd that all is well.

The host is the program that has started its robots' processes. If it is killed, or suspended by the system, each
robot's root process notices that and makes the robot safe, as after the end of a script. The host itself energises
no robot, and holds no lease.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import signal
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import msgspec
import trio

from strands_actors.caller.processes.run_directory import LockFile, try_lock
from strands_actors.caller.session.portal import open_caller

from .adapters import Adapters, adapters_file
from .child import Child
from .fleet import BadFleet, Fleet, RobotSpec
from .fleet_file import read_fleet
from .keeper import Ground, Keeper, Phase, RobotStatus
from .messages import LINE_BYTES, FaultOf, HostStatus, Order, Verb, lock_path, socket_path
from .notify import ALIVE, READY, RELOADING, STOPPING, Notifier
from .services import ENTRIES

GUARD_S = 0.5
"""Period of the question to each guardian."""
CLIENT_S = 5.0
"""Longest time in which a client must send its order."""

_log = logging.getLogger("strands_actors")


class AnotherHost(Exception):
    """A host of this user runs already."""


@contextlib.contextmanager
def only_host() -> Iterator[None]:
    """Hold the lock of this user's host. Raise ``AnotherHost`` if another process has it."""
    lock = LockFile(lock_path())
    try:
        if not try_lock(lock.fd, fcntl.LOCK_EX):
            pid = os.pread(lock.fd, 32, 0).decode(errors="replace").strip() or "unknown"
            raise AnotherHost(
                f"a host of this user runs already (process {pid}). Change its file and run "
                "`strands-actors reload`, or end it: strands-actors down"
            )
        os.ftruncate(lock.fd, 0)
        os.pwrite(lock.fd, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        lock.close()


class Host:
    """Keeps the robots of a file. Only the trio loop of its nursery may call it.

    Args:
        fleet: The file.
        ground: What all robots share.
        notifier: The connection to systemd.
    """

    def __init__(self, fleet: Fleet, ground: Ground, notifier: Notifier) -> None:
        self._fleet = fleet
        self._ground = ground
        self._notifier = notifier
        self._kept: dict[str, tuple[Keeper, trio.CancelScope]] = {}
        self._services: dict[str, tuple[Child, trio.CancelScope]] = {}
        self._changing = trio.Lock()
        self.is_down = trio.Event()
        """Set when the host must end."""

    async def run(self) -> None:
        """Start all robots, and tell systemd when each is up, or known not to be."""
        for spec in self._fleet.robots.values():
            self._start(spec)
        for name in self._fleet.services:
            self._start_service(name)
        for keeper, _ in list(self._kept.values()):
            await keeper.settled.wait()
        self._notifier.send(READY, await self._line())

    async def guard(self) -> None:
        """Ask each guardian again and again, and tell systemd that the host is alive if all answer."""
        while True:
            answers: list[bool] = []

            async def ask(keeper: Keeper, answers: list[bool] = answers) -> None:
                answers.append(await keeper.guard())

            async with trio.open_nursery() as nursery:
                for keeper, _ in self._kept.values():
                    nursery.start_soon(ask, keeper)
            if all(answers):
                self._notifier.send(ALIVE)
            await trio.sleep(GUARD_S)

    async def end(self) -> None:
        """Make all robots safe, and end their processes."""
        self._notifier.send(STOPPING)
        async with self._changing:
            await self._stop(list(self._kept))
            for _, scope in self._services.values():
                scope.cancel()

    # -- robots

    def _start(self, spec: RobotSpec) -> None:
        keeper, scope = Keeper(spec, self._ground), trio.CancelScope()

        async def keep() -> None:
            with scope:
                await keeper.run()

        self._kept[spec.name] = keeper, scope
        self._ground.nursery.start_soon(keep)

    async def _stop(self, names: list[str]) -> None:
        """Make robots safe at the same time, and end their processes."""
        stopping = [self._kept[name] for name in names]
        for _, scope in stopping:
            scope.cancel()
        for keeper, _ in stopping:
            await keeper.ended.wait()
        for name in names:
            del self._kept[name]

    def _start_service(self, name: str) -> None:
        child, scope = Child(name, ENTRIES[name], self._fleet.services[name]), trio.CancelScope()
        self._services[name] = child, scope

        async def serve() -> None:
            with scope:
                await child.run()

        self._ground.nursery.start_soon(serve)

    def _change_services(self, before: Fleet) -> None:
        """Stop and start the services that the file has changed."""
        for name in {*before.services, *self._fleet.services}:
            if before.services.get(name) == self._fleet.services.get(name):
                continue
            if name in self._services:
                self._services.pop(name)[1].cancel()
            if name in self._fleet.services:
                self._start_service(name)

    async def reload(self) -> HostStatus:
        """Read the file again. Only the robots that it changes are stopped and started."""
        async with self._changing:
            try:
                fleet = await trio.to_thread.run_sync(read_fleet, self._fleet.path)
            except BadFleet as bad:
                status = await self.status()
                return msgspec.structs.replace(status, faults=[FaultOf(*fault) for fault in bad.faults])
            self._notifier.send(RELOADING)
            before, self._fleet = self._fleet, fleet
            removed = [name for name, spec in before.robots.items() if fleet.robots.get(name) != spec]
            new = [name for name, spec in fleet.robots.items() if before.robots.get(name) != spec]
            await self._stop(removed)
            for name in new:
                self._start(fleet.robots[name])
            for name, (keeper, _) in self._kept.items():
                if name not in new:
                    keeper.hurry()
            self._change_services(before)
            for name in new:
                await self._kept[name][0].settled.wait()
            self._notifier.send(READY, await self._line())
            return msgspec.structs.replace(await self.status(), changed=sorted({*removed, *new}))

    # -- status

    async def status(self) -> HostStatus:
        rows: dict[str, RobotStatus] = {}

        async def ask(name: str, keeper: Keeper) -> None:
            rows[name] = await keeper.status()

        async with trio.open_nursery() as nursery:
            for name, (keeper, _) in self._kept.items():
                nursery.start_soon(ask, name, keeper)
        return HostStatus(
            os.getpid(),
            str(self._fleet.path),
            [rows[name] for name in sorted(rows)],
            {name: child.status for name, (child, _) in sorted(self._services.items())},
            self._ground.adapters.problem,
        )

    async def _line(self) -> str:
        """Return the line that ``systemctl status`` shows."""
        robots = (await self.status()).robots
        up = sum(robot.phase == Phase.UP for robot in robots)
        return f"STATUS={up} of {len(robots)} robots are up"

    # -- orders

    async def obey(self, stream: trio.abc.Stream) -> None:
        """Answer one client. A client cannot end or block the host."""
        with contextlib.suppress(trio.BrokenResourceError, trio.ClosedResourceError):
            async with stream:
                order = await _order(stream)
                if order is None:
                    return
                match order.order:
                    case Verb.STATUS:
                        answer = await self.status()
                    case Verb.RELOAD:
                        answer = await self.reload()
                    case Verb.DOWN:
                        answer = await self.status()
                        await self.end()
                with trio.move_on_after(CLIENT_S):
                    await stream.send_all(msgspec.json.encode(answer) + b"\n")
                if order.order is Verb.DOWN:
                    self.is_down.set()


async def _order(stream: trio.abc.Stream) -> Order | None:
    """Return the order of a client; None if it sends none in time."""
    data = b""
    with trio.move_on_after(CLIENT_S):
        while not data.endswith(b"\n") and len(data) < LINE_BYTES:
            part = await stream.receive_some()
            if not part:
                return None
            data += bytes(part)
        try:
            return msgspec.json.decode(data, type=Order)
        except (msgspec.MsgspecError, UnicodeDecodeError):
            return None
    return None


@contextlib.asynccontextmanager
async def _listening() -> AsyncIterator[trio.SocketListener]:
    """Listen at the host's socket. ``only_host`` is held, so a leftover of an earlier host is replaced."""
    path = socket_path()
    path.unlink(missing_ok=True)
    listener = trio.SocketListener(_bound(path))
    try:
        yield listener
    finally:
        path.unlink(missing_ok=True)
        await trio.aclose_forcefully(listener)


def _bound(path: Path) -> trio.socket.SocketType:
    import socket

    server = socket.socket(socket.AF_UNIX)
    server.bind(str(path))
    path.chmod(0o600)
    server.listen()
    return trio.socket.from_stdlib_socket(server)


async def keep_robots(fleet: Fleet, new_adapters: bool, on_ready: Callable[[HostStatus], None]) -> None:
    """Keep the robots of a file until SIGINT, SIGTERM, or the order to go down. SIGHUP reads the file again.

    Args:
        fleet: The file.
        new_adapters: Forget which USB adapter each robot had.
        on_ready: Called once with the status when each robot is up, or known not to be.
    """
    adapters = Adapters(adapters_file())
    if new_adapters:
        adapters.forget()
    notifier = Notifier()
    async with open_caller() as (node, nursery, entrance):
        host = Host(fleet, Ground(node, nursery, entrance, adapters), notifier)
        with trio.open_signal_receiver(signal.SIGINT, signal.SIGTERM, signal.SIGHUP) as signals:
            async with _listening() as listener, trio.open_nursery() as own:

                async def heed() -> None:
                    async for number in signals:
                        if number != signal.SIGHUP:
                            break
                        own.start_soon(host.reload)
                    await host.end()
                    host.is_down.set()

                async def begin() -> None:
                    await host.run()
                    on_ready(await host.status())

                own.start_soon(heed)
                own.start_soon(trio.serve_listeners, host.obey, [listener])
                own.start_soon(host.guard)
                own.start_soon(begin)
                await host.is_down.wait()
                own.cancel_scope.cancel()
