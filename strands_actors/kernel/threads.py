"""A call that can wait, in a thread, and the least that is between.

``trio.to_thread.run_sync`` waits its turn at a limiter and copies a context first: the call begins
25 us later in a loop that is busy, and 100 us later in one that slept, as a wire has that is told
to stop.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TypeVar, TypeVarTuple, cast

import outcome
import trio

Args = TypeVarTuple("Args")
Result = TypeVar("Result")


async def call_in_thread(function: Callable[[*Args], Result], *args: *Args) -> Result:
    """``function(*args)``, its result or what it raises. Cancelled, the loop goes on at once, and
    the call, which cannot be ended, by itself: what it comes to is nobody's. As many at a time as
    callers wait."""
    await trio.lowlevel.checkpoint_if_cancelled()
    task, token = trio.lowlevel.current_task(), trio.lowlevel.current_trio_token()
    is_waited_for = True

    def done(result: outcome.Outcome[Result]) -> None:
        if is_waited_for:
            trio.lowlevel.reschedule(task, result)

    def deliver(result: outcome.Outcome[Result]) -> None:  # in the thread
        with contextlib.suppress(trio.RunFinishedError):
            token.run_sync_soon(done, result)

    def abort(_: object) -> trio.lowlevel.Abort:
        nonlocal is_waited_for
        is_waited_for = False
        return trio.lowlevel.Abort.SUCCEEDED

    trio.lowlevel.start_thread_soon(lambda: function(*args), deliver)
    return cast(Result, await trio.lowlevel.wait_task_rescheduled(abort))
