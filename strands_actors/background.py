"""Tasks that run beside a block and end with it."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator

import trio


@contextlib.asynccontextmanager
async def open_background() -> AsyncIterator[trio.Nursery]:
    """A nursery that is cancelled when the block has been left, by whatever way, and not before: what cancels the
    block from outside reaches the block alone, which may need those tasks to clear away (a robot is made safe by
    way of them). What the block raises comes out as it is: trio's own nursery would wrap it in a group."""
    failure: Exception | None = None
    async with trio.open_nursery() as outer:
        nursery: trio.Nursery = await outer.start(_run)
        try:
            yield nursery
        except Exception as error:
            failure = error
        finally:
            nursery.cancel_scope.cancel()
    if failure is not None:
        raise failure


async def _run(task_status: trio.TaskStatus[trio.Nursery]) -> None:
    with trio.CancelScope(shield=True):
        async with trio.open_nursery() as nursery:
            task_status.started(nursery)
            await trio.sleep_forever()
