"""Helpers of the kernel's tests: decorators that run a test on trio, messages, and an actor that records
the messages it handles.
"""

from __future__ import annotations

import functools
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import trio
from trio.testing import MockClock

from strands_actors.kernel.actor import Actor, Cell, Deferred
from strands_actors.kernel.channels.local_mesh import LocalNetwork
from strands_actors.kernel.clock import Clock, VirtualClock
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import Node

LIMIT_S = 60.0
PATIENCE_S = 10.0

AsyncTest = Callable[..., Awaitable[None]]


def _run(test: AsyncTest, limit_s: float, clock: Callable[[], MockClock] | None) -> Callable[..., None]:
    @functools.wraps(test)
    def run(*args: Any, **kwargs: Any) -> None:
        async def main() -> None:
            with trio.fail_after(limit_s):
                await test(*args, **kwargs)

        trio.run(main, clock=clock() if clock is not None else None)

    return run


def real_time(test: AsyncTest) -> Callable[..., None]:
    """Run an async test on trio. A test that hangs fails."""
    return _run(test, LIMIT_S, None)


def virtual_time(test: AsyncTest) -> Callable[..., None]:
    """Run an async test on trio without waiting: the clock jumps whenever all tasks wait."""
    return _run(test, 100_000.0, lambda: MockClock(autojump_threshold=0))


async def until(condition: Callable[[], bool]) -> None:
    """Poll a condition that has no event."""
    with trio.fail_after(PATIENCE_S):
        while not condition():  # noqa: ASYNC110
            await trio.sleep(0.001)


class Number(Message, frozen=True):
    value: int


class Newest(Message, frozen=True):
    lane = "latest"

    value: int


class Other(Message, frozen=True):
    """Like ``Newest``, but with its own place in the mailbox."""

    lane = "latest"

    value: int


class Alarm(Message, frozen=True):
    lane = "urgent"

    value: int


class Block(Message, frozen=True):
    """Do not return from ``receive`` before ``Recorder.release`` is set."""


class Never(Message, frozen=True):
    """Do not answer before ``LateAnswer``."""


class LateAnswer(Message, frozen=True):
    pass


class Boom(Message, frozen=True):
    text: str


class Table(Message, frozen=True):
    """A message with a field of any content, like an action of a robot."""

    rows: dict[str, Any]
    names: tuple[str, ...] = ()


class Unwanted(Message, frozen=True):
    """A message that no actor of these tests accepts."""

    value: int


class Recorder(Actor):
    """Keep all handled messages in order, across restarts."""

    def __init__(self, log: list[Message]) -> None:
        self.log = log
        self.blocked = trio.Event()
        self.release = trio.Event()
        self._late: list[Deferred] = []

    async def receive(
        self, message: Number | Newest | Other | Alarm | Block | Never | LateAnswer | Boom | Table
    ) -> Number | Newest | Other | Alarm | Table | Refused | Deferred | None:
        self.log.append(message)
        match message:
            case Block():
                self.blocked.set()
                await self.release.wait()
            case Never():
                late = self.context.defer()
                self._late.append(late)
                return late
            case LateAnswer():
                self.answer()
            case Boom():
                raise ValueError(message.text)
            case _:
                return message
        return None

    def answer(self) -> None:
        """Answer all ``Never`` messages."""
        for late in self._late:
            late.send(Number(-1))


@asynccontextmanager
async def running_node(name: str = "n", clock: Clock | None = None) -> AsyncIterator[tuple[Node, trio.Nursery]]:
    """Run a node that has no peers. Yield it with a nursery for its cells."""
    node = Node(name, clock or VirtualClock())
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        yield node, nursery
        nursery.cancel_scope.cancel()


@asynccontextmanager
async def recorder() -> AsyncIterator[tuple[Node, Cell, list[Message]]]:
    """Run a node with one recorder."""
    log: list[Message] = []
    async with running_node() as (node, nursery):
        cell = node.cell("r/actor/recorder", lambda: Recorder(log))
        await nursery.start(cell.run)
        yield node, cell, log


def local_pair() -> tuple[LocalNetwork, Node, Node]:
    """Return two nodes on one network in memory. Neither runs yet."""
    network = LocalNetwork()
    nodes = []
    for name in ("here", "there"):
        mesh = network.join()
        node = Node(name, VirtualClock(), mesh)
        mesh.attach(node)
        nodes.append(node)
    return network, nodes[0], nodes[1]
