"""Several boards at once: each on its port, none waits for another."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TypeVar

import trio

from strands_actors.contract.wire import WireDown

T = TypeVar("T")


async def together(*calls: Callable[[], Awaitable[T]]) -> list[T]:
    """Return the results, in the order of the calls. Raise the first ``WireDown`` when all have
    ended, so that no call is cut short by another's failure."""
    results: dict[int, T] = {}
    failures: list[WireDown] = []

    async def run(at: int, call: Callable[[], Awaitable[T]]) -> None:
        try:
            results[at] = await call()
        except WireDown as down:
            failures.append(down)

    async with trio.open_nursery() as nursery:
        for at, call in enumerate(calls):
            nursery.start_soon(run, at, call)
    if failures:
        raise failures[0]
    return [results[at] for at in range(len(calls))]
