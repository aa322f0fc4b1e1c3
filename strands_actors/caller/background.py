"""Tasks that run beside a block and end with it."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator

import trio


@contextlib.asynccontextmanager
async def open_background() -> AsyncIterator[trio.Nursery]:
    """A nursery that is cancelled when the block has been left, by whatever way, and not before:
    what cancels the block from outside reaches the block alone, which may need those tasks to clear
    away (a robot is made safe by way of them). What the block raises comes out as it is, a Ctrl-C too:
    trio's own nursery would wrap it in a group, with which Python ends as after any other failure."""
    failure: Exception | KeyboardInterrupt | None = None
    scope = trio.CancelScope(shield=True)
    tasks: list[trio.Nursery] = []
    there = trio.Event()

    async def run() -> None:
        with scope:
            async with trio.open_nursery() as nursery:
                tasks.append(nursery)
                there.set()
                await trio.sleep_forever()

    async with trio.open_nursery() as outer:
        outer.start_soon(run)
        try:
            await there.wait()
            yield tasks[0]
        except (Exception, KeyboardInterrupt) as error:
            failure = error
        finally:
            scope.cancel()
    if failure is not None:
        raise failure
