"""The actor that is born and dies in ``benchmarks.sides.life``, in a process of its own.

The parent imports this, so that what it forks children from has it in memory, as a robot's root has
what its children run.
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
    """Entry of the process."""
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
