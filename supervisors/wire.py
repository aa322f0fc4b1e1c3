"""The wire group: gate, watchdog and transport, in one loop, with nothing else in it.

If one of the three breaks, the group ends as a whole and the guardian takes over: half a chain is never
repaired in place.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from typing import Any

import trio

from strands_actors.runtime.actor import describe
from strands_actors.runtime.channel import Channel
from strands_actors.runtime.clock import Clock, MonotonicClock
from strands_actors.runtime.contract import Driver
from strands_actors.runtime.forked import Standby
from strands_actors.runtime.link import Link
from strands_actors.runtime.node import Node
from strands_actors.runtime.process import ChildProcess, start
from strands_actors.runtime.processor import Standing, suspected
from strands_actors.runtime.pulse import Pulse, on_page
from strands_actors.runtime.realtime import WIRE_PRIORITY, run_first
from strands_actors.runtime.supervisor import Budget, ChildSpec, Supervisor
from strands_actors.runtime.zenoh_mesh import ZenohMesh
from strands_actors.runtime.zenoh_session import hand_over

from . import addresses, channels
from .census import CensusTaker
from .failsafe import Mode, State
from .gate import Gate
from .lines import WireEnd
from .loading import load_driver
from .messages import RootGone
from .tap import Attached, TapKeeper, name_of
from .transport import Transport
from .watchdog import Watchdog

ROOT_END, WIRE_END = 0, 1
"""Of the page on which root and wire beat."""
UNCONFIRMED = 4
"""Exit code of a wire process whose root is gone, when a motor did not confirm the safe state."""


async def run_group(
    node: Node,
    driver: Driver,
    robot: str,
    start_state: State,
    cause: str,
    orphaned: Callable[[bool], None],
    pulse: Pulse,
    root: Callable[[], Standing | None] = lambda: None,
    locked_since: str = "",
    task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED,
) -> None:
    """Run until cancelled; raise when any of the three fails."""
    at = addresses.of(robot)
    cells = [
        node.cell(
            at.path("transport"),
            lambda: Transport(driver, at.gate, at.watchdog, at.guardian, start_state.epoch),
        ),
        node.cell(
            at.path("gate"),
            lambda: Gate(driver, at.transport, at.watchdog, at.guardian, start_state, cause, locked_since),
        ),
        node.cell(
            at.path("watchdog"),
            lambda: Watchdog(driver.timing, at.gate, at.transport, orphaned, pulse, root),
        ),
    ]
    try:
        supervisor = Supervisor([ChildSpec(cell.role, cell.run) for cell in cells], budget=Budget(restarts=0))
        await supervisor.run(task_status=task_status)
    finally:
        for cell in cells:
            node.release(cell)


def tap_keeper(node: Node, driver: Driver, description: dict[str, Any], robot: str) -> TapKeeper:
    """For who wants to record the gate and the watchdog of a wire group."""
    at = addresses.of(robot)

    def remember() -> Iterator[tuple[str, int, object]]:
        for address in (at.gate, at.watchdog):
            cell = node.cells.get(address)
            if cell is not None and isinstance(cell.actor, Gate | Watchdog):
                yield name_of(address), cell.actor.context.deferrals, cell.actor.memory()

    names = {address: name_of(address) for address in (at.gate, at.watchdog)}
    return TapKeeper(names, Attached(description, driver.axes, driver.unit), remember)


class ProcessPlace:
    """The wire group in a child process."""

    def __init__(self, node: Node, nursery: trio.Nursery, args: dict[str, Any], standby: Standby) -> None:
        entry = "strands_actors.supervisors.wire:main"
        self.process: ChildProcess = standby.start(entry, args) or start(entry, args, (args["page"],))
        nursery.start_soon(self.process.link(node, channels.of_wire(args["robot"])).run)

    async def ended(self) -> str:
        code = await self.process.wait()
        return f"the wire process ended with {'signal' if code < 0 else 'code'} {abs(code)}"

    async def fence(self) -> None:
        await self.process.fence()

    def standing(self) -> Standing | None:
        return suspected(self.process.pid)


class InlinePlace:
    """The wire group in this process's loop: for tests, under virtual time too."""

    def __init__(
        self,
        node: Node,
        nursery: trio.Nursery,
        driver: Driver,
        robot: str,
        state: State,
        cause: str,
        pulse: Pulse,
    ) -> None:
        self._scope = trio.CancelScope()
        self._ended = trio.Event()
        self._why = "the wire group ended"
        nursery.start_soon(self._run, node, driver, robot, state, cause, pulse)

    async def _run(self, node: Node, driver: Driver, robot: str, state: State, cause: str, pulse: Pulse) -> None:
        try:
            with self._scope:
                await run_group(node, driver, robot, state, cause, lambda _: self._scope.cancel(), pulse)
        except Exception as error:
            self._why = describe(error)
        finally:
            self._ended.set()

    async def ended(self) -> str:
        await self._ended.wait()
        return self._why

    async def fence(self) -> None:
        self._scope.cancel()
        await self._ended.wait()

    def standing(self) -> None:
        return None  # it stands where we stand


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Entry of the wire process."""
    hand_over()
    trio.run(_main, args, sock)


async def _main(args: dict[str, Any], sock: socket.socket) -> None:
    clock: Clock = MonotonicClock()
    robot: str = args["robot"]
    at = addresses.of(robot)
    driver = load_driver(args["driver"])
    if driver.timing.realtime:
        run_first(WIRE_PRIORITY)
    node = Node(f"{robot}.wire.{os.getpid()}", clock)
    state = State(Mode(args["mode"]), args["epoch"], args["locked_by"])
    root_channel = channels.of_root(robot)
    node.linked = root_channel.hosts or frozenset()
    link = Link(node, sock, lambda: node.ref(at.watchdog).tell(RootGone()), root_channel)

    def channel_of(writer: str) -> Channel:
        """Of a line: a policy's has a name."""
        return channels.of_policy(robot, writer) if writer else channels.of_caller(robot, args["caller"])

    root = os.getppid()
    pulse = on_page(args["page"], WIRE_END)

    def end(confirmed: bool) -> None:
        os._exit(0 if confirmed else UNCONFIRMED)

    async def join_mesh() -> None:
        mesh = await ZenohMesh.open(args["listen"], args["connect"])
        mesh.channel = channels.of_user(robot)
        mesh.attach(node)
        await mesh.run()

    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await nursery.start(
            run_group,
            node,
            driver,
            robot,
            state,
            args["cause"],
            end,
            pulse,
            lambda: suspected(root),
            args["locked_since"],
        )
        await nursery.start(node.cell(at.path("wire_end"), lambda: WireEnd(channel_of)).run)
        nursery.start_soon(link.run)
        nursery.start_soon(join_mesh)
        nursery.start_soon(node.cell(at.census("wire"), CensusTaker, "census").run)
        tap = node.cell(at.tap("wire"), lambda: tap_keeper(node, driver, args["driver"], robot), "tap")
        nursery.start_soon(tap.run)
