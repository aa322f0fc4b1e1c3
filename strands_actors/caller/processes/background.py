"""Run tasks in the background of an ``async with`` block. They are cancelled at the end of the block."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator

import trio


@contextlib.asynccontextmanager
async def open_background() -> AsyncIterator[trio.Nursery]:
    """Open a nursery for background tasks. They are cancelled after the block, and never before.

    If a cancellation from outside ends the block, the background tasks still run. The block may need them to
    clean up, for example to make a robot safe.

    The block's exception is raised unchanged, also KeyboardInterrupt. A plain trio nursery would wrap it in an
    exception group, and Python would then not end as after Ctrl-C.
    """
    failure: Exception | KeyboardInterrupt | None = None
    scope = trio.CancelScope(shield=True)
    tasks: list[trio.Nursery] = []
    opened = trio.Event()

    async def run() -> None:
        with scope:
            async with trio.open_nursery() as nursery:
                tasks.append(nursery)
                opened.set()
                await trio.sleep_forever()

    async with trio.open_nursery() as outer:
        outer.start_soon(run)
        try:
            await opened.wait()
            yield tasks[0]
        except (Exception, KeyboardInterrupt) as error:
            failure = error
        finally:
            scope.cancel()
    if failure is not None:
        raise failure
