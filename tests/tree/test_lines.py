"""Writer and wire tell each other by a line of their own, and have another when the wire is another process."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import AsyncIterator

import pytest
import trio

from strands_actors.runtime.actor import Actor
from strands_actors.runtime.channel import Channel
from strands_actors.runtime.clock import MonotonicClock
from strands_actors.runtime.link import Link
from strands_actors.runtime.messages import Message
from strands_actors.runtime.node import AskTimeout, Node, Unreachable
from strands_actors.runtime.thread_line import NotSent, ThreadLine
from strands_actors.supervisors import addresses
from strands_actors.supervisors.lines import Switchboard, WireEnd, keep_line, keep_thread_line

AT = addresses.of("r")
PATIENCE_S = 20.0


class Ping(Message, frozen=True):
    pass


class Pong(Message, frozen=True):
    life: int


class Hardware(Actor):
    """What only the wire process hosts."""

    def __init__(self, life: int) -> None:
        self.life = life

    def receive(self, message: Ping) -> Pong:
        return Pong(self.life)


@contextlib.asynccontextmanager
async def process(name: str) -> AsyncIterator[tuple[Node, trio.Nursery]]:
    node = Node(name, MonotonicClock())
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        yield node, nursery
        nursery.cancel_scope.cancel()


async def connect(one: Node, other: Node, nursery: trio.Nursery) -> None:
    for node, sock in zip((one, other), socket.socketpair(), strict=True):
        await nursery.start(Link(node, sock).run)


async def reached(caller: Node, life: int) -> None:
    """Until the caller is answered by that life of the wire."""
    with trio.fail_after(PATIENCE_S):
        while True:
            with contextlib.suppress(Unreachable, AskTimeout):
                if await caller.ref(AT.gate, Hardware).ask(Ping(), 0.5) == Pong(life):
                    return
            await trio.sleep(0.01)


def test_a_caller_that_has_a_link_to_the_root_alone_gets_a_line_to_each_wire() -> None:
    """No mesh is there that could carry it."""

    async def run() -> None:
        async with process("root") as (root, root_tasks), process("caller") as (caller, caller_tasks):
            await root_tasks.start(root.cell(AT.path("switchboard"), lambda: Switchboard(AT.wire_end)).run)
            await connect(caller, root, caller_tasks)
            caller_tasks.start_soon(keep_line, caller, "r")
            for life in (1, 2):
                async with process(f"wire.{life}") as (wire, wire_tasks):
                    await wire_tasks.start(wire.cell(AT.path("wire_end"), lambda: WireEnd(lambda _: Channel())).run)
                    await wire_tasks.start(wire.cell(AT.path("gate"), lambda life=life: Hardware(life)).run)  # type: ignore[misc]
                    await connect(wire, root, wire_tasks)
                    await reached(caller, life)
                with pytest.raises(Unreachable):
                    with trio.fail_after(PATIENCE_S):
                        while True:
                            await caller.ref(AT.gate, Hardware).ask(Ping(), 0.5)

    trio.run(run)


def test_a_thread_gets_a_line_to_each_wire_too() -> None:
    """None while there is none: who asks then goes another way."""
    line: ThreadLine | None = None

    def hand(present: ThreadLine | None) -> None:
        nonlocal line
        line = present

    async def answered(life: int) -> None:
        with trio.fail_after(PATIENCE_S):
            while True:
                if line is not None:
                    with contextlib.suppress(NotSent):
                        assert await trio.to_thread.run_sync(line.ask, Ping(), PATIENCE_S) == Pong(life)
                        return
                await trio.sleep(0.01)

    async def run() -> None:
        async with process("root") as (root, root_tasks), process("caller") as (caller, caller_tasks):
            await root_tasks.start(root.cell(AT.path("switchboard"), lambda: Switchboard(AT.wire_end)).run)
            await connect(caller, root, caller_tasks)
            caller_tasks.start_soon(keep_thread_line, caller, "r", Hardware, hand)
            await trio.sleep(0.05)  # what must not happen has no event to wait for
            assert line is None, "no wire took it"
            for life in (1, 2):
                async with process(f"wire.{life}") as (wire, wire_tasks):
                    await wire_tasks.start(wire.cell(AT.path("wire_end"), lambda: WireEnd(lambda _: Channel())).run)
                    await wire_tasks.start(wire.cell(AT.path("gate"), lambda life=life: Hardware(life)).run)  # type: ignore[misc]
                    await connect(wire, root, wire_tasks)
                    await answered(life)
                with pytest.raises(NotSent), trio.fail_after(PATIENCE_S):
                    while line is not None:
                        await trio.to_thread.run_sync(line.ask, Ping(), PATIENCE_S)
                    raise NotSent
        assert line is None

    trio.run(run)
