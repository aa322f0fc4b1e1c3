"""How old a setpoint is when a slow reader takes it: ``python -m benchmarks.sides.age SIDE [short]``.

The producer is a process of its own. Ours tells an actor, over the link that a child has to its parent; beside it
a task reads the same socket into a trio channel. The reader is busy in a worker thread, as a policy that infers is:
a timer of its loop would go off as the loop wakes for the producer, and see new setpoints only.
"""

from __future__ import annotations

import time

import trio

from benchmarks.house import Figures
from strands_actors.runtime.actor import Actor, Cell
from strands_actors.runtime.clock import MonotonicClock
from strands_actors.runtime.node import Node
from strands_actors.runtime.process import start

from .age_producer import SENT, STAMP_BYTES, TOLD, Setpoint
from .common import answer, percentiles

READER_S = 0.005


def span_s(short: bool) -> float:
    return 1.0 if short else 4.0


async def ours(short: bool) -> Figures:
    ages_ns: list[int] = []
    waiting: list[int] = []

    class Reader(Actor):
        async def receive(self, message: Setpoint) -> None:
            ages_ns.append(time.monotonic_ns() - message.made_ns)
            await trio.to_thread.run_sync(time.sleep, READER_S)
            waiting.append(len(cell.mailbox))

    node = Node("bench", MonotonicClock())
    cell: Cell = node.cell("bench/actor/reader", Reader)
    producer = start(TOLD, {})
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await nursery.start(cell.run)
        await nursery.start(producer.link(node).run)
        await over(short, ages_ns)
        nursery.cancel_scope.cancel()
    await producer.fence()
    return figures(ages_ns, waiting)


async def trio_channel(short: bool) -> Figures:
    ages_ns: list[int] = []
    waiting: list[int] = []
    sender, receiver = trio.open_memory_channel[Setpoint](float("inf"))
    producer = start(SENT, {})
    stream = trio.SocketStream(trio.socket.from_stdlib_socket(producer.socket))

    async def take() -> None:
        rest = b""
        async for data in stream:
            rest += data
            while len(rest) >= STAMP_BYTES:
                sender.send_nowait(Setpoint(int.from_bytes(rest[:STAMP_BYTES], "little")))
                rest = rest[STAMP_BYTES:]

    async def serve() -> None:
        async for setpoint in receiver:
            ages_ns.append(time.monotonic_ns() - setpoint.made_ns)
            await trio.to_thread.run_sync(time.sleep, READER_S)
            waiting.append(receiver.statistics().current_buffer_used)

    async with trio.open_nursery() as nursery:
        nursery.start_soon(take)
        nursery.start_soon(serve)
        await over(short, ages_ns)
        nursery.cancel_scope.cancel()
    await producer.fence()
    return figures(ages_ns, waiting)


async def over(short: bool, ages_ns: list[int]) -> None:
    """Return when the span has passed since the first setpoint came."""
    with trio.fail_after(20.0):
        while not ages_ns:  # noqa: ASYNC110  # what waits for an event of ours would be measured, too
            await trio.sleep(0.01)
    await trio.sleep(span_s(short))


def figures(ages_ns: list[int], waiting: list[int]) -> Figures:
    return {**percentiles("age", ages_ns), "waiting_most": float(max(waiting))}


if __name__ == "__main__":
    answer(
        {
            "ours": lambda short: trio.run(ours, short),
            "trio": lambda short: trio.run(trio_channel, short),
        }
    )
