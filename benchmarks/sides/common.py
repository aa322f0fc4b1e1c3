"""Parts that all sides (measured programs) share: messages, percentiles, and the output of figures."""

from __future__ import annotations

import json
import sys
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any

import trio

from benchmarks.house import Figures
from strands_actors.kernel.actor import Actor, Cell
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Node, Ref


class State(Message, frozen=True):
    """A robot's state: a reading of seven joints. It has 217 bytes when it is encoded."""

    seq: int
    stamp_ns: int
    robot: str
    q: tuple[float, ...]
    dq: tuple[float, ...]
    tau: tuple[float, ...]


class GetCount(Message, frozen=True):
    pass


class Count(Message, frozen=True):
    n: int


class Counter(Actor):
    """Count ``State`` messages. The answer to ``GetCount`` is the number of ``State`` messages that came before
    it.
    """

    def __init__(self) -> None:
        self.n = 0

    def receive(self, message: State | GetCount) -> Count | None:
        if type(message) is State:
            self.n += 1
            return None
        return Count(self.n)


STATE = State(1, 2, "arm/left", (0.1,) * 7, (0.2,) * 7, (0.3,) * 7)


@asynccontextmanager
async def hosted(actor: Callable[[], Actor], capacity: int | None = None) -> AsyncIterator[tuple[Ref, Cell]]:
    """Run one actor in this process. Yield a reference for sending to it, and the cell (its mailbox and loop)."""
    node = Node("bench", MonotonicClock())
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        cell = node.cell("bench/actor/one", actor)
        if capacity is not None:
            cell.mailbox.capacity = capacity
        await nursery.start(cell.run)
        yield node.ref(cell.address, type(cell.actor)), cell
        nursery.cancel_scope.cancel()


def percentiles(name: str, spans_ns: list[int]) -> Figures:
    """Return the median and the 99th percentile, as ``<name>_p50_us`` and ``<name>_p99_us``, of durations in
    nanoseconds.
    """
    ordered = sorted(spans_ns)
    return {
        f"{name}_p50_us": ordered[len(ordered) // 2] / 1e3,
        f"{name}_p99_us": ordered[min(len(ordered) - 1, len(ordered) * 99 // 100)] / 1e3,
    }


def answer(sides: Mapping[str, Callable[[bool], Any]]) -> None:
    """Run the side (program) that the command line names (``side [short]``), and print its figures as JSON."""
    print(json.dumps(sides[sys.argv[1]]("short" in sys.argv[2:])), flush=True)
