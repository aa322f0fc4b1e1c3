"""Call several boards at the same time. Each board has its own port, so no call waits for another."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TypeVar

import trio

from strands_actors.contract.wire import WireDown

T = TypeVar("T")


async def together(*calls: Callable[[], Awaitable[T]]) -> list[T]:
    """Run all calls and return their results in order. A failed call does not cancel the others. When all have
    ended, raise the first ``WireDown``."""
    results: dict[int, T] = {}
    failures: list[WireDown] = []

    async def run(index: int, call: Callable[[], Awaitable[T]]) -> None:
        try:
            results[index] = await call()
        except WireDown as down:
            failures.append(down)

    async with trio.open_nursery() as nursery:
        for index, call in enumerate(calls):
            nursery.start_soon(run, index, call)
    if failures:
        raise failures[0]
    return [results[index] for index in range(len(calls))]
