"""The actor that ``benchmarks.sides.life`` starts and kills, in a separate process.

The parent imports this module before it forks the spawner. So the spawner's children have the code in memory,
as the processes of a robot do.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress
from typing import Any

import trio

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Node, Unreachable

from .common import Count, GetCount

DEADLINE_S = 20.0
PARENT = "strands/bench/actor/parent"
CHILD = "strands/bench/actor/child"
ENTRY = "benchmarks.sides.life_child:live"


class Up(Message, frozen=True):
    pid: int


class Child(Actor):
    def receive(self, message: GetCount) -> Count:
        return Count(os.getpid())


def live(args: dict[str, Any], sock: socket.socket) -> None:
    """Run the child process with its actor, and report to the parent that the actor is ready."""
    trio.run(_live, sock)


async def _live(sock: socket.socket) -> None:
    node = Node("child", MonotonicClock())
    link = Link(node, sock)
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await nursery.start(node.cell("bench/actor/child", Child).run)
        await nursery.start(link.run)
        while True:
            with suppress(Unreachable):
                await node.ref(PARENT).ask(Up(os.getpid()), DEADLINE_S)
                break
            await trio.sleep(0.0005)
