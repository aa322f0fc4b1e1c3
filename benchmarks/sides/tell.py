"""Measure messages without an answer to one actor in the same process: ``python -m benchmarks.sides.tell SIDE
[short]``.

SIDE is the name of the program that is measured. With ``short`` the run is short.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from typing import Any

import trio

from benchmarks.house import Figures
from strands_actors.kernel.mailbox import CAPACITY

from .common import STATE, Count, Counter, GetCount, answer, hosted

WINDOW = CAPACITY - 1
"""Messages that are sent before the sender asks, with a mailbox of the usual size. By asking, the sender waits
until the mailbox is empty."""


def amount(short: bool) -> int:
    return 100_000 if short else 400_000


def rate(n: int, began_s: float) -> float:
    return n / (time.perf_counter() - began_s)


async def ours(short: bool) -> Figures:
    n = amount(short)
    async with hosted(Counter, capacity=n + 1) as (actor, _):
        began_s = time.perf_counter()
        for _ in range(n):
            actor.tell(STATE)
        assert await actor.ask(GetCount(), 60.0) == Count(n)
        tell_per_s = rate(n, began_s)
    async with hosted(Counter) as (actor, _):
        n -= n % WINDOW
        began_s = time.perf_counter()
        for _ in range(n // WINDOW):
            for _ in range(WINDOW):
                actor.tell(STATE)
            await actor.ask(GetCount(), 60.0)
        bounded_per_s = rate(n, began_s)
        assert await actor.ask(GetCount(), 60.0) == Count(n)
    return {"tell_per_s": tell_per_s, "bounded_per_s": bounded_per_s}


async def trio_channel(short: bool) -> Figures:
    n = amount(short) // 4

    async def count(receiver: trio.MemoryReceiveChannel[Any], done: trio.Event) -> None:
        counted = 0
        async for _ in receiver:
            counted += 1
        assert counted == n
        done.set()

    figures: Figures = {}
    for figure, bound in (("tell_per_s", float("inf")), ("bounded_per_s", CAPACITY)):
        sender, receiver = trio.open_memory_channel[Any](bound)
        done = trio.Event()
        async with trio.open_nursery() as nursery:
            nursery.start_soon(count, receiver, done)
            await trio.lowlevel.checkpoint()
            began_s = time.perf_counter()
            if figure == "tell_per_s":
                for _ in range(n):
                    sender.send_nowait(STATE)
            else:
                for _ in range(n):
                    await sender.send(STATE)
            sender.close()
            await done.wait()
            figures[figure] = rate(n, began_s)
    return figures


def bare(short: bool) -> Figures:
    """Measure a deque and a direct call of the handler. Messages are sent in groups that fit into a mailbox."""
    n = amount(short) - amount(short) % WINDOW
    waiting: deque[Any] = deque()
    counter = Counter()
    receive, put, take = counter.receive, waiting.append, waiting.popleft
    began_s = time.perf_counter()
    for _ in range(n // WINDOW):
        for _ in range(WINDOW):
            put(STATE)
        while waiting:
            receive(take())
    assert counter.n == n
    return dict.fromkeys(("tell_per_s", "bounded_per_s"), rate(n, began_s))


async def asyncio_queue(short: bool) -> Figures:
    n = amount(short)

    async def count(queue: asyncio.Queue[Any]) -> None:
        counted = 0
        while await queue.get() is not None:
            counted += 1
        assert counted == n

    figures: Figures = {}
    for figure, bound in (("tell_per_s", 0), ("bounded_per_s", CAPACITY)):
        queue: asyncio.Queue[Any] = asyncio.Queue(bound)
        reader = asyncio.create_task(count(queue))
        await asyncio.sleep(0)
        began_s = time.perf_counter()
        if bound:
            for _ in range(n):
                await queue.put(STATE)
        else:
            for _ in range(n):
                queue.put_nowait(STATE)
        await queue.put(None)
        await reader
        figures[figure] = rate(n, began_s)
    return figures


def pykka(short: bool) -> Figures:
    import pykka

    n = amount(short) // 8

    class Counter(pykka.ThreadingActor):
        def __init__(self) -> None:
            super().__init__()
            self.n = 0

        def on_receive(self, message: object) -> int | None:
            if message is None:
                return self.n
            self.n += 1
            return None

    actor = Counter.start()
    began_s = time.perf_counter()
    for _ in range(n):
        actor.tell(STATE)
    assert actor.ask(None, timeout=60.0) == n
    figures = {"tell_per_s": rate(n, began_s)}
    actor.stop()
    return figures


if __name__ == "__main__":
    answer(
        {
            "ours": lambda short: trio.run(ours, short),
            "trio": lambda short: trio.run(trio_channel, short),
            "asyncio": lambda short: asyncio.run(asyncio_queue(short)),
            "pykka": pykka,
            "bare": bare,
        }
    )
