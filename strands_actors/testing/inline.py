"""Run all actors of a robot in one process, on one trio loop. Under ``MockClock`` they run in virtual time."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass

import trio
import trio.testing

from strands_actors.contract.driver import Driver
from strands_actors.kernel.clock import Clock, VirtualClock
from strands_actors.kernel.health import busy
from strands_actors.kernel.health.heartbeat import pair
from strands_actors.kernel.node import Node, Ref
from strands_actors.kernel.supervisor import Budget, ChildSpec, Supervisor
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.failsafe import State
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import GetStatus, Status
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.root.guardian import Guardian
from strands_actors.supervisors.root.lock_keeper import LockKeeper
from strands_actors.supervisors.root.locks import Locks
from strands_actors.supervisors.wire.group import InlineWire

from .fake import HARDWARE, FakeDriver, FakeHardware

_ports = itertools.count()


@dataclass
class InlineTree:
    """The actors of one robot (guardian, gate, watchdog and transport), and the hardware that they command."""

    node: Node
    driver: Driver
    hardware: FakeHardware
    gate: Ref
    guardian: Ref
    keeper: Guardian
    wires_made: list[InlineWire]

    @property
    def wire(self) -> InlineWire:
        """The present instance of the group of actors that writes to the robot. A restart makes a new one."""
        return self.wires_made[-1]

    async def status(self) -> Status:
        """Return the status of the gate (the actor that checks commands).

        Raise if it does not answer within 1 s.
        """
        answer = await self.gate.ask(GetStatus(), 1.0)
        assert isinstance(answer, Status), answer
        return answer

    async def until(self, mode: str, within_s: float = 10.0) -> Status:
        """Wait until the gate's status shows this mode (``disarmed``, ``armed`` and so on)."""
        with trio.fail_after(within_s):
            while True:
                if self.gate.address in self.node.cells:
                    # The gate may have ended since the check above.
                    answer = await self.gate.ask(GetStatus(), 1.0)
                    if isinstance(answer, Status) and answer.mode == mode:
                        return answer
                await trio.sleep(0.002)


@contextlib.asynccontextmanager
async def open_inline_tree(
    hardware: FakeHardware | None = None,
    clock: Clock | None = None,
    budget: Budget | None = None,
    driver: Driver | None = None,
    locks: Locks | None = None,
) -> AsyncIterator[InlineTree]:
    """Start all actors of a robot in this process. The robot is then connected and disarmed.

    Args:
        hardware: The hardware of a ``FakeDriver``.
        clock: By default a clock in virtual time.
        budget: How often the group of actors that writes to the robot may restart. By default 100 times in 5 s.
        driver: The driver to use. By default a ``FakeDriver``.
        locks: The store for the locks of e-stops. None does not store locks.
    """
    hardware = hardware or FakeHardware()
    port = f"fake-{next(_ports)}"
    HARDWARE[port] = hardware
    driver = driver or FakeDriver("fake", port, {})
    robot_addresses = addresses.of(port)
    node = Node(port, clock or VirtualClock())
    wires_made: list[InlineWire] = []
    roots, wires = pair()
    safety_page = SafetyPage()
    try:
        async with trio.open_nursery() as nursery:

            def start_wire(state: State, cause: str) -> InlineWire:
                wires_made.append(InlineWire(node, nursery, driver, port, state, cause, wires, safety_page))
                return wires_made[-1]

            await nursery.start(node.run)
            keeper = None if locks is None else LockKeeper(locks)
            if keeper is not None:
                nursery.start_soon(keeper.run)
            guardian = Guardian(
                driver, roots, start_wire, gate=robot_addresses.gate, keeper=keeper, safety_page=safety_page
            )
            await nursery.start(node.cell(robot_addresses.path("guardian"), lambda: guardian).run)
            supervisor = Supervisor([ChildSpec("wire", guardian.keep)], budget=budget or Budget(100, 5.0))
            nursery.start_soon(supervisor.run)
            tree = InlineTree(
                node,
                driver,
                hardware,
                node.ref(robot_addresses.gate, Gate),
                node.ref(robot_addresses.guardian, Guardian),
                guardian,
                wires_made,
            )
            await tree.until("disarmed")
            yield tree
            nursery.cancel_scope.cancel()
    finally:
        del HARDWARE[port]


def run_virtual(test: Callable[[], Awaitable[None]]) -> None:
    """Run an async test in virtual time. Waiting takes no real time, and deadlines are exact."""
    with busy.assumed(busy.IDLE):
        trio.run(test, clock=trio.testing.MockClock(autojump_threshold=0))
