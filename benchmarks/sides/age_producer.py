"""The producer of ``benchmarks.sides.age``, in a process of its own: no timer is shared with who reads."""

from __future__ import annotations

import socket
import time
from contextlib import aclosing
from typing import Any

import trio

from strands_actors.runtime.clock import MonotonicClock
from strands_actors.runtime.link import Link
from strands_actors.runtime.messages import Message
from strands_actors.runtime.node import Node, Ref

PERIOD_S = 0.001
READER = "strands/bench/actor/reader"
TOLD = "benchmarks.sides.age_producer:told"
SENT = "benchmarks.sides.age_producer:sent"
STAMP_BYTES = 8


class Setpoint(Message, frozen=True):
    lane = "latest"

    made_ns: int


def told(args: dict[str, Any], sock: socket.socket) -> None:
    """Entry: setpoints are told to an actor over the link of the process."""
    trio.run(_tell, sock)


async def _tell(sock: socket.socket) -> None:
    node = Node("producer", MonotonicClock())
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await nursery.start(Link(node, sock).run)
        reader: Ref = node.ref(READER)
        async with aclosing(MonotonicClock().ticks(PERIOD_S)) as ticks:
            async for _ in ticks:
                reader.tell(Setpoint(time.monotonic_ns()))


def sent(args: dict[str, Any], sock: socket.socket) -> None:
    """Entry: their times alone, on the socket itself."""
    trio.run(_send, sock)


async def _send(sock: socket.socket) -> None:
    async with aclosing(MonotonicClock().ticks(PERIOD_S)) as ticks:
        async for _ in ticks:
            sock.send(time.monotonic_ns().to_bytes(STAMP_BYTES, "little"))
