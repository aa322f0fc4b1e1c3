"""Measure requests with a deadline to an actor in the same process: ``python -m benchmarks.sides.ask SIDE
[short]``.

SIDE is the name of the program that is measured. With ``short`` the run is short.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable

import trio

from benchmarks.house import Figures

from .common import Count, Counter, GetCount, answer, hosted, percentiles

DEADLINE_S = 1.0
WARM = 500


def amount(short: bool) -> int:
    return 4_000 if short else 20_000


async def timed(n: int, ask: Callable[[], Awaitable[object]]) -> Figures:
    for _ in range(WARM):
        await ask()
    spans_ns = []
    for _ in range(n):
        began_ns = time.perf_counter_ns()
        await ask()
        spans_ns.append(time.perf_counter_ns() - began_ns)
    return percentiles("ask", spans_ns)


async def ours(short: bool) -> Figures:
    async with hosted(Counter) as (actor, _):
        assert await actor.ask(GetCount(), DEADLINE_S) == Count(0)
        return await timed(amount(short), lambda: actor.ask(GetCount(), DEADLINE_S))


async def trio_channel(n: int) -> Figures:
    sender, receiver = trio.open_memory_channel[trio.MemorySendChannel[Count]](1024)

    async def serve() -> None:
        async for reply in receiver:
            await reply.send(Count(0))

    async def ask() -> Count:
        with trio.fail_after(DEADLINE_S):
            reply, replied = trio.open_memory_channel[Count](1)
            await sender.send(reply)
            return await replied.receive()

    async with trio.open_nursery() as nursery:
        nursery.start_soon(serve)
        figures = await timed(n, ask)
        nursery.cancel_scope.cancel()
    return figures


async def asyncio_queue(short: bool) -> Figures:
    queue: asyncio.Queue[asyncio.Future[Count]] = asyncio.Queue(1024)

    async def serve() -> None:
        while True:
            (await queue.get()).set_result(Count(0))

    async def ask() -> Count:
        async with asyncio.timeout(DEADLINE_S):
            reply: asyncio.Future[Count] = asyncio.get_running_loop().create_future()
            await queue.put(reply)
            return await reply

    server = asyncio.create_task(serve())
    figures = await timed(amount(short), ask)
    server.cancel()
    return figures


def pykka(short: bool) -> Figures:
    import pykka

    class Server(pykka.ThreadingActor):
        def on_receive(self, message: object) -> Count:
            return Count(0)

    actor = Server.start()
    spans_ns = []
    for _ in range(amount(short) // 4):
        began_ns = time.perf_counter_ns()
        actor.ask(None, timeout=DEADLINE_S)
        spans_ns.append(time.perf_counter_ns() - began_ns)
    actor.stop()
    return percentiles("ask", spans_ns)


if __name__ == "__main__":
    answer(
        {
            "ours": lambda short: trio.run(ours, short),
            "trio": lambda short: trio.run(trio_channel, amount(short)),
            "asyncio": lambda short: asyncio.run(asyncio_queue(short)),
            "pykka": pykka,
        }
    )
