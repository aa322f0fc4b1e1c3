"""Run a blocking call in a thread, with little overhead.

``trio.to_thread.run_sync`` first waits for a limiter and copies a context. So its call begins 25 us later in a
busy loop, and 100 us later in a loop that slept, like that of a wire process which receives a stop.
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
    """Return the result of ``function(*args)``, or raise its exception.

    If the caller is cancelled, the loop continues at once. The call cannot be ended, so it continues too, and
    its result is dropped. There is no limit to the number of calls at a time.
    """
    await trio.lowlevel.checkpoint_if_cancelled()
    task, token = trio.lowlevel.current_task(), trio.lowlevel.current_trio_token()
    is_waited_for = True

    def done(result: outcome.Outcome[Result]) -> None:
        if is_waited_for:
            trio.lowlevel.reschedule(task, result)

    # This runs in the thread of the call.
    def deliver(result: outcome.Outcome[Result]) -> None:
        with contextlib.suppress(trio.RunFinishedError):
            token.run_sync_soon(done, result)

    def abort(_: object) -> trio.lowlevel.Abort:
        nonlocal is_waited_for
        is_waited_for = False
        return trio.lowlevel.Abort.SUCCEEDED

    trio.lowlevel.start_thread_soon(lambda: function(*args), deliver)
    return cast(Result, await trio.lowlevel.wait_task_rescheduled(abort))
