"""The loop can run an actor in the turn of the sender of a message. Messages, order and failures stay the
same as without this.
"""

from __future__ import annotations

import time

import pytest
import trio
import trio.lowlevel
from trio.testing import wait_all_tasks_blocked

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import PROMPT, Node

from .kernel import Alarm, Number, real_time, until


def new_node() -> Node:
    return Node("t", MonotonicClock())


class Chain(Actor):
    """Log each message, and send it to the next actor."""

    def __init__(self, name: str, log: list[str], next_address: str = "") -> None:
        self.name, self.log, self.next = name, log, next_address

    def receive(self, message: Number | Alarm) -> Number | None:
        self.log.append(f"{self.name}+{message.value}")
        if self.next:
            self.context.ref(self.next).tell(message)
        self.log.append(f"{self.name}-{message.value}")
        return message if isinstance(message, Number) else None


class Passes(trio.abc.Instrument):
    """Count the steps of tasks."""

    def __init__(self) -> None:
        self.steps = 0

    def before_task_step(self, task: trio.lowlevel.Task) -> None:
        self.steps += 1


async def chain_of(node: Node, nursery: trio.Nursery, names: str, log: list[str]) -> None:
    for name, after in zip(names, (*names[1:], ""), strict=True):
        address = f"strands/t/actor/{after}" if after else ""
        cell = node.cell(f"t/actor/{name}", lambda name=name, address=address: Chain(name, log, address))
        await nursery.start(cell.run)


@real_time
async def test_a_chain_runs_in_one_turn_and_no_handler_runs_inside_another() -> None:
    node, passes = new_node(), Passes()
    log: list[str] = []
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await chain_of(node, nursery, "abc", log)
        await wait_all_tasks_blocked()
        trio.lowlevel.add_instrument(passes)
        with node.dispatch:
            node.ref("strands/t/actor/a").tell(Number(1))
            assert log == [], "no handler runs before the turn is over"
        trio.lowlevel.remove_instrument(passes)
        assert log == ["a+1", "a-1", "b+1", "b-1", "c+1", "c-1"]
        assert passes.steps == 0
        nursery.cancel_scope.cancel()


@real_time
async def test_the_order_of_a_sender_and_the_urgent_lane_are_kept() -> None:
    node = new_node()
    log: list[str] = []
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await chain_of(node, nursery, "a", log)
        await wait_all_tasks_blocked()
        with node.dispatch:
            for value in range(3):
                node.ref("strands/t/actor/a").tell(Number(value))
            node.ref("strands/t/actor/a").tell(Alarm(9))
        assert [entry for entry in log if "+" in entry] == ["a+9", "a+0", "a+1", "a+2"]
        nursery.cancel_scope.cancel()


class Fragile(Actor):
    def receive(self, message: Number) -> Number:
        if message.value < 0:
            raise ValueError("negative")
        return message


@real_time
async def test_an_exception_in_an_inline_actor_fails_only_that_actor() -> None:
    """The asker gets a refusal, the sender's turn continues, and the actor's own task fails."""
    node = new_node()
    failed: list[str] = []
    cell = node.cell("t/actor/fragile", Fragile)

    async def keep() -> None:
        try:
            await cell.run()
        except* ValueError as group:
            failed.append(str(group.exceptions[0]))

    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        nursery.start_soon(keep)
        await wait_all_tasks_blocked()
        ref = node.ref(cell.address, Fragile)
        answer = await ref.ask(Number(-1), 5.0)
        assert isinstance(answer, Refused) and answer.code == "crashed" and "negative" in answer.reason
        await until(lambda: bool(failed))
        assert failed == ["negative"]
        nursery.cancel_scope.cancel()


class Echo(Actor):
    """One of two actors that send messages to each other without end."""

    def __init__(self, other: str) -> None:
        self.other, self.count = other, 0

    def receive(self, message: Number) -> None:
        self.count += 1
        self.context.ref(self.other).tell(message)


@real_time
async def test_an_endless_turn_lets_other_tasks_run() -> None:
    node = new_node()
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        for one, other in ("ab", "ba"):
            cell = node.cell(f"t/actor/{one}", lambda other=other: Echo(f"strands/t/actor/{other}"))
            await nursery.start(cell.run)
        await wait_all_tasks_blocked()
        began = time.monotonic()
        node.ref("strands/t/actor/a").tell(Number(1))
        for _ in range(20):
            await trio.sleep(0.001)
        assert time.monotonic() - began < 10
        nursery.cancel_scope.cancel()


@real_time
async def test_a_task_that_asks_without_pause_lets_others_run() -> None:
    node = new_node()
    log: list[str] = []
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await chain_of(node, nursery, "a", log)
        await wait_all_tasks_blocked()
        ran: list[int] = []

        async def other() -> None:
            ran.append(len(log))

        nursery.start_soon(other)
        for value in range(2 * PROMPT):  # trio may run this task again before the other one at first
            await node.ref("strands/t/actor/a", Chain).ask(Number(value), 5.0)
        assert ran
        nursery.cancel_scope.cancel()


class Slow(Actor):
    """An asynchronous actor that is prompt for numbers that are not negative. It logs each message, and
    whether its own task handled it.
    """

    def __init__(self, log: list[tuple[int, bool]], liar: bool = False) -> None:
        self.log, self.liar = log, liar

    async def started(self) -> None:
        self.task = trio.lowlevel.current_task()

    def is_prompt(self, message: Message) -> bool:
        return isinstance(message, Number) and message.value >= 0

    async def receive(self, message: Number | Alarm) -> Number | None:
        if not self.is_prompt(message) or self.liar:
            await trio.sleep(0.001)
        self.log.append((message.value, trio.lowlevel.current_task() is self.task))
        return message if isinstance(message, Number) else None


@real_time
async def test_an_asynchronous_actor_runs_inline_as_long_as_it_is_prompt() -> None:
    node: Node = new_node()
    log: list[tuple[int, bool]] = []
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await nursery.start(node.cell("t/actor/slow", lambda: Slow(log)).run)
        await wait_all_tasks_blocked()
        ref = node.ref("strands/t/actor/slow", Slow)
        with node.dispatch:
            for value in (1, 2, -3, 4):
                ref.tell(Number(value))
        assert log == [(1, False), (2, False)]
        assert await ref.ask(Number(5), 5.0) == Number(5)
        assert [value for value, _ in log] == [1, 2, -3, 4, 5]
        assert log[2] == (-3, True)
        nursery.cancel_scope.cancel()


@real_time
async def test_an_actor_that_claims_to_be_prompt_but_waits_fails() -> None:
    node = new_node()
    with pytest.raises(ExceptionGroup) as caught:
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            await nursery.start(node.cell("t/actor/slow", lambda: Slow([], liar=True)).run)
            await wait_all_tasks_blocked()
            with node.dispatch:
                node.ref("strands/t/actor/slow").tell(Number(1))
            await trio.sleep(5)
    assert "is_prompt returned True" in str(caught.value.exceptions[0].exceptions[0])  # type: ignore[attr-defined]
