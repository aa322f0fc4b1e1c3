"""Run tasks in the background of a block. They end with the block."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator

import trio


@contextlib.asynccontextmanager
async def open_background() -> AsyncIterator[trio.Nursery]:
    """Open a nursery. Its tasks are cancelled after the block, and never before.

    A cancellation from outside reaches the block, but not these tasks. The block may need them to clean
    up: a robot is made safe by them.

    The block's exception is raised unchanged, also KeyboardInterrupt. A plain trio nursery would wrap it
    in an exception group, and Python would not end as after Ctrl-C.
    """
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
