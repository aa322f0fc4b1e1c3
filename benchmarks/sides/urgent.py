"""Measure a stop that arrives behind 10 000 messages of 20 us each: ``python -m benchmarks.sides.urgent SIDE
[short]``.

SIDE is the name of the program that is measured. With ``short`` the run is short.
"""

from __future__ import annotations

import time

import trio

from benchmarks.house import Figures
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.messages import Message

from .common import answer, hosted, percentiles

QUEUED = 10_000
HANDLER_NS = 20_000


class Work(Message, frozen=True):
    pass


class Stop(Message, frozen=True):
    lane = "urgent"

    sent_ns: int


class Worker:
    """Compute 20 us for each message until the stop arrives. Later messages are ignored."""

    def __init__(self, spans_ns: list[int]) -> None:
        self.spans_ns = spans_ns
        self.stopped = False

    def work(self) -> None:
        if not self.stopped:
            until_ns = time.perf_counter_ns() + HANDLER_NS
            while time.perf_counter_ns() < until_ns:
                pass

    def stop(self, stop: Stop) -> None:
        self.spans_ns.append(time.perf_counter_ns() - stop.sent_ns)
        self.stopped = True


def trials(short: bool) -> int:
    return 5 if short else 40


async def ours(short: bool) -> Figures:
    spans_ns: list[int] = []

    class Busy(Actor):
        def __init__(self) -> None:
            self.worker = Worker(spans_ns)

        def receive(self, message: Work | Stop) -> None:
            if type(message) is Stop:
                self.worker.stop(message)
            else:
                self.worker.work()

    for _ in range(trials(short)):
        async with hosted(Busy, capacity=QUEUED) as (actor, _):
            for _ in range(QUEUED):
                actor.tell(Work())
            # Wait until the actor computes.
            await trio.sleep(0.002)
            actor.tell(Stop(time.perf_counter_ns()))
            await actor.ask(Work(), 60.0)
    return percentiles("urgent", spans_ns)


async def trio_channel(short: bool) -> Figures:
    spans_ns: list[int] = []

    async def serve(receiver: trio.MemoryReceiveChannel[Work | Stop]) -> None:
        worker = Worker(spans_ns)
        async for message in receiver:
            if type(message) is Stop:
                worker.stop(message)
            else:
                worker.work()

    for _ in range(2 if short else 8):
        sender, receiver = trio.open_memory_channel[Work | Stop](float("inf"))
        async with trio.open_nursery() as nursery:
            for _ in range(QUEUED):
                sender.send_nowait(Work())
            nursery.start_soon(serve, receiver)
            await trio.sleep(0.002)
            sender.send_nowait(Stop(time.perf_counter_ns()))
            sender.close()
    return percentiles("urgent", spans_ns)


def pykka(short: bool) -> Figures:
    import pykka

    spans_ns: list[int] = []

    class Busy(pykka.ThreadingActor):
        def __init__(self) -> None:
            super().__init__()
            self.worker = Worker(spans_ns)

        def on_receive(self, message: Work | Stop) -> None:
            if type(message) is Stop:
                self.worker.stop(message)
            else:
                self.worker.work()

    for _ in range(2 if short else 8):
        actor = Busy.start()
        for _ in range(QUEUED):
            actor.tell(Work())
        actor.tell(Stop(time.perf_counter_ns()))
        actor.ask(Work(), timeout=60.0)
        actor.stop()
    return percentiles("urgent", spans_ns)


if __name__ == "__main__":
    answer(
        {
            "ours": lambda short: trio.run(ours, short),
            "trio": lambda short: trio.run(trio_channel, short),
            "pykka": pykka,
        }
    )
