"""Tasks (named policies) in the root: a start that is late, and a stop without an answer. In virtual
time; the frames on the wire decide.
"""

from __future__ import annotations

import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import trio

from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.permissions import Channel
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import Node, Ref
from strands_actors.kernel.processes.process import ChildProcess
from strands_actors.kernel.supervisor import ChildSpec, Supervisor
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import Acquire, Lease
from strands_actors.supervisors.root.messages import GetTask, Rollout, StartTask, StopTask, TaskStatus
from strands_actors.supervisors.root.tasks import Tasks
from strands_actors.testing import InlineTree, open_inline_tree, run_virtual

from .writer import Writer, armed, freeze, setpoints

S = 1_000_000_000


class Mover(Actor):
    """A policy that takes the lease and sends a setpoint every 20 ms until it is stopped."""

    def __init__(self, tree: InlineTree, over: int) -> None:
        self._writer = Writer(tree, "policy")
        self._over = over
        self._moves = True

    async def started(self) -> None:
        self.context.start_soon(self._move)

    def receive(self, message: StopTask) -> TaskStatus:
        self._moves = False
        return TaskStatus(exit_reason="stopped")

    async def _move(self) -> None:
        lease = await self._writer.ref.ask(Acquire("policy", over=self._over), 1.0)
        assert isinstance(lease, Lease), lease
        self._writer.lease = lease
        while self._moves:
            self._writer.ref.tell(self._writer.setpoint(a=1.0))
            await trio.sleep(0.02)


class InlineProcess(ChildProcess):
    """A policy "process" in this loop. It moves the robot until it is killed."""

    def __init__(self, tree: InlineTree, over: int) -> None:
        super().__init__(4711, None)  # type: ignore[arg-type]
        self._cell = tree.node.cell(addresses.of(robot_of(tree)).path("policy"), lambda: Mover(tree, over))
        self._scope = trio.CancelScope()
        self._ended = trio.Event()

    async def run(self) -> None:
        try:
            with self._scope:
                await self._cell.run()
        finally:
            self._cell.node.release(self._cell)
            self._ended.set()

    @property
    def alive(self) -> bool:
        return not self._ended.is_set()

    def kill(self, sig: int = signal.SIGKILL) -> None:
        self._scope.cancel()

    async def wait(self) -> int:
        await self._ended.wait()
        return -signal.SIGKILL

    def link(self, node: Node, channel: Channel | None = None) -> Any:
        return _Link()

    async def fence(self, within_s: float = 1.0) -> bool:
        self.kill()
        await self._ended.wait()
        return True


class _Link:
    async def run(self) -> None:
        await trio.sleep_forever()


@asynccontextmanager
async def tasks_of(tree: InlineTree, start_s: float = 0.0, safe_s: float = 1.5) -> AsyncIterator[Ref]:
    """Run the tree's tasks actor. Its processes take ``start_s`` to start, and a stop may take ``safe_s``."""
    path = addresses.of(robot_of(tree)).path("tasks")
    async with trio.open_nursery() as nursery:

        async def start(entry: str, args: dict[str, Any]) -> ChildProcess:
            await trio.sleep(start_s)
            rollout = msgspec.convert(args["rollout"], Rollout)
            process = InlineProcess(tree, rollout.over)
            nursery.start_soon(process.run)
            return process

        made = Tasks(robot_of(tree), start, "", safe_s=safe_s)
        cell = tree.node.cell(path, lambda: made)
        await nursery.start(Supervisor([ChildSpec("tasks", cell.run)]).run)
        yield tree.node.ref(cell.address, Tasks)
        nursery.cancel_scope.cancel()


def robot_of(tree: InlineTree) -> str:
    return tree.gate.address.split("/")[1]


def start_message(tree: InlineTree, writer: Writer, within_s: float) -> StartTask:
    deadline_ns = tree.node.clock.now_ns() + round(within_s * S)
    rollout = Rollout(robot_of(tree), tree.driver.axes, "", 0.02, 0.1, 60.0, over=writer.lease.id)
    return StartTask("no:where", {}, rollout, deadline_ns)


async def running(tasks: Ref) -> bool:
    status = await tasks.ask(GetTask(), 1.0)
    assert isinstance(status, TaskStatus)
    return status.running


def test_saf_010_a_task_that_starts_too_late_moves_nothing() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree, tasks_of(tree, start_s=4.0) as tasks:
            writer = await armed(tree)
            answer = await tasks.ask(start_message(tree, writer, within_s=2.0), 5.0)
            assert isinstance(answer, Refused) and answer.code == "expired", answer
            await trio.sleep(2.0)
            assert setpoints(tree) == []
            assert not await running(tasks)

    run_virtual(run)


def test_a_task_that_starts_in_time_moves_the_robot() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree, tasks_of(tree, start_s=0.5) as tasks:
            writer = await armed(tree)
            answer = await tasks.ask(start_message(tree, writer, within_s=2.0), 5.0)
            assert isinstance(answer, TaskStatus) and answer.running, answer
            await trio.sleep(0.5)
            assert setpoints(tree)
            assert isinstance(await tasks.ask(StopTask(), 1.0), TaskStatus)
            assert not await running(tasks)

    run_virtual(run)


def test_saf_003_stopping_a_task_while_the_wire_is_dead_ends_no_actor() -> None:
    """The policy does not answer, and there is no gate to ask."""

    async def run() -> None:
        async with open_inline_tree() as tree, tasks_of(tree) as tasks:
            writer = await armed(tree)
            await tasks.ask(start_message(tree, writer, within_s=2.0), 5.0)
            await trio.sleep(0.1)
            freeze(tree, "policy")
            slow(tree.keeper.channels.own)
            tree.wire._scope.cancel()
            status = await tasks.ask(StopTask(), 2.0)
            assert isinstance(status, TaskStatus) and not status.running, status
            assert "the wire process has ended" in status.exit_detail
            assert tree.node.cells[tasks.address].incarnations == 1, "the actor was not restarted"
            await tree.until("disarmed")
            assert tree.hardware.energised == [False, False]

    run_virtual(run)


def test_saf_010_stopping_a_task_without_an_answer_of_the_wire_fences_it() -> None:
    """The wire hangs while it holds the robot."""

    async def run() -> None:
        async with open_inline_tree() as tree, tasks_of(tree) as tasks:
            writer = await armed(tree)
            await tasks.ask(start_message(tree, writer, within_s=2.0), 5.0)
            await trio.sleep(0.1)
            requested_ns = tree.node.clock.now_ns()
            freeze(tree, "policy")
            transport = tree.node.cells[addresses.of(robot_of(tree)).transport].actor
            slow(transport._wire)  # type: ignore[attr-defined]
            status = await tasks.ask(StopTask(), 2.0)
            assert isinstance(status, TaskStatus) and not status.running, status
            assert "is now killed" in status.exit_detail
            await tree.until("disarmed")
            assert tree.hardware.of("safe", requested_ns)[-1].path == "stop_channel"
            assert tree.hardware.energised == [False, False]

    run_virtual(run)


def test_stopping_a_task_does_not_fence_a_robot_that_declares_a_long_stop() -> None:
    """Such as a drone that lands, or a base behind a slow service."""

    async def run() -> None:
        async with open_inline_tree() as tree, tasks_of(tree, safe_s=4.0) as tasks:
            writer = await armed(tree)
            await tasks.ask(start_message(tree, writer, within_s=2.0), 5.0)
            await trio.sleep(0.1)
            requested_ns = tree.node.clock.now_ns()
            freeze(tree, "policy")
            tree.hardware.confirm_s = 1.0
            status = await tasks.ask(StopTask(), 6.0)
            assert isinstance(status, TaskStatus) and not status.running, status
            assert "is now killed" not in status.exit_detail
            assert {sent.path for sent in tree.hardware.of("safe", requested_ns)} == {"wire"}
            assert tree.hardware.energised == [True, True], "the robot holds"

    run_virtual(run)


def slow(way: Any) -> None:
    """Delay the beginning of make_safe by a second."""
    make_safe = way.make_safe

    async def late(safe_state: str) -> tuple[MotorReport, ...]:
        await trio.sleep(1.0)
        reports: tuple[MotorReport, ...] = await make_safe(safe_state)
        return reports

    way.make_safe = late


def test_a_restarted_tasks_actor_ends_the_process_of_the_earlier_one() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree, tasks_of(tree) as tasks:
            writer = await armed(tree)
            await tasks.ask(start_message(tree, writer, within_s=2.0), 5.0)
            await trio.sleep(0.1)
            actor = tree.node.cells[tasks.address].actor
            assert isinstance(actor, Tasks)
            actor.context.start_soon(_fails)
            await trio.sleep(0.1)
            failed_ns = tree.node.clock.now_ns()
            assert not await running(tasks)
            await trio.sleep(0.5)
            assert setpoints(tree, failed_ns) == []

    run_virtual(run)


async def _fails() -> None:
    raise RuntimeError("a fault was asked for")
