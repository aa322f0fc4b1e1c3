"""How old a setpoint is when a slow reader takes it: ``python -m benchmarks.sides.age SIDE [short]``."""

from __future__ import annotations

import time
from contextlib import aclosing

import trio

from benchmarks.house import Figures
from strands_actors.runtime.actor import Actor
from strands_actors.runtime.clock import MonotonicClock
from strands_actors.runtime.messages import Message

from .common import answer, hosted, percentiles

PERIOD_S = 0.001
READER_S = 0.005


class Setpoint(Message, frozen=True):
    lane = "latest"

    made_ns: int


def span_s(short: bool) -> float:
    return 1.0 if short else 4.0


async def ours(short: bool) -> Figures:
    ages_ns: list[int] = []
    waiting: list[int] = []

    class Reader(Actor):
        async def receive(self, message: Setpoint) -> None:
            ages_ns.append(time.monotonic_ns() - message.made_ns)
            await trio.sleep(READER_S)

    async with hosted(Reader) as (one, cell):
        with trio.move_on_after(span_s(short)):
            async with aclosing(MonotonicClock().ticks(PERIOD_S)) as ticks:
                async for _ in ticks:
                    one.tell(Setpoint(time.monotonic_ns()))
                    waiting.append(len(cell.mailbox))
    return {**percentiles("age", ages_ns), "waiting_most": float(max(waiting))}


async def trio_channel(short: bool) -> Figures:
    ages_ns: list[int] = []
    waiting: list[int] = []
    sender, receiver = trio.open_memory_channel[Setpoint](float("inf"))

    async def serve() -> None:
        async for setpoint in receiver:
            ages_ns.append(time.monotonic_ns() - setpoint.made_ns)
            await trio.sleep(READER_S)

    async with trio.open_nursery() as nursery:
        nursery.start_soon(serve)
        with trio.move_on_after(span_s(short)):
            async with aclosing(MonotonicClock().ticks(PERIOD_S)) as ticks:
                async for _ in ticks:
                    sender.send_nowait(Setpoint(time.monotonic_ns()))
                    waiting.append(sender.statistics().current_buffer_used)
        nursery.cancel_scope.cancel()
    return {**percentiles("age", ages_ns), "waiting_most": float(max(waiting))}


if __name__ == "__main__":
    answer(
        {
            "ours": lambda short: trio.run(ours, short),
            "trio": lambda short: trio.run(trio_channel, short),
        }
    )
