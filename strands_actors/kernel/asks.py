"""Pending answers of requests (asks), and their deadlines."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import cast

import msgspec
import outcome
import trio

from .messages import Message


class AskTimeout(Exception):
    """The answer did not come before the deadline. The request may still have been carried out, so stop the
    robot afterwards.
    """


class Unreachable(Exception):
    """The actor does not exist, or it has ended. It may have read the request before its end. The text is for
    users.
    """


def not_running(address: str) -> Unreachable:
    return Unreachable(f"the {_spoken(address)} is not running")


def went_away(address: str) -> Unreachable:
    return Unreachable(f"the {_spoken(address)} went away, perhaps with what it was asked")


def _spoken(address: str) -> str:
    """Return the readable form of an address: ``gate of so101`` for ``strands/so101/actor/gate``."""
    host, _, actor = address.partition("/actor/")
    return f"{actor} of {host.rpartition('/')[2]}" if actor else address


class Answer:
    """The pending answer of one request. The reply may come before the sender waits for it."""

    __slots__ = ("_task", "_value", "connection", "decode", "done", "expires_at", "to")

    def __init__(self, decode: Callable[[msgspec.Raw], Message | None] | None) -> None:
        self.decode = decode
        self.to = ""
        """The address of the receiver, if it lives in another process."""
        self.connection: object = None
        """The link or the mesh over which the request left. An answer that comes over another one is refused."""
        self.done = False
        self.expires_at = 0.0
        self._task: trio.lowlevel.Task | None = None
        self._value: outcome.Outcome[Message | None] | None = None

    def send(self, answer: Message | None) -> None:
        self._settle(outcome.Value(answer))

    def fail(self, error: Exception) -> None:
        self._settle(outcome.Error(error))

    def _settle(self, value: outcome.Outcome[Message | None]) -> None:
        if self.done:
            return
        self.done = True
        if self._task is None:
            self._value = value
        else:
            trio.lowlevel.reschedule(self._task, value)
            self._task = None

    async def wait(self) -> Message | None:
        if self._value is not None:
            await trio.lowlevel.checkpoint_if_cancelled()
            return self._value.unwrap()

        def abort(_: object) -> trio.lowlevel.Abort:
            self.done = True
            self._task = None
            return trio.lowlevel.Abort.SUCCEEDED

        self._task = trio.lowlevel.current_task()
        return cast("Message | None", await trio.lowlevel.wait_task_rescheduled(abort))


STALLED_S = 0.01
"""A loop that wakes so much later than it wanted to (seconds) had no processor, or a handler has blocked it."""
CATCH_UP_S = 0.02
"""Seconds that such a loop takes to read the answers that came meanwhile."""


class Deadlines:
    """Let requests expire that were not answered in time.

    After a stall of the loop, an answer may have come before its deadline, and wait to be read. So the loop first
    reads what has come, and then the request expires.

    Requests with the same timeout expire in the order in which they were made. So there is one queue for each
    timeout, and one task for all queues. (``trio.fail_after`` around each request would take twice the time of
    the request.)
    """

    def __init__(self) -> None:
        self._queues: dict[float, deque[Answer]] = {}
        self._next_at = float("inf")
        self._wake = trio.Event()

    def add(self, answer: Answer, duration_s: float) -> None:
        queue = self._queues.setdefault(duration_s, deque())
        while queue and queue[0].done:
            queue.popleft()
        answer.expires_at = trio.current_time() + duration_s
        queue.append(answer)
        # If the new deadline is not the earliest one, the running task wakes up early enough.
        if answer.expires_at < self._next_at:
            self._wake.set()

    async def run(self) -> None:
        while True:
            now = trio.current_time()
            next_at = float("inf")
            for duration_s in list(self._queues):
                queue = self._queues[duration_s]
                while queue and (queue[0].done or queue[0].expires_at <= now):
                    queue.popleft().fail(AskTimeout(f"no answer within {duration_s:g} s"))
                if queue:
                    next_at = min(next_at, queue[0].expires_at)
                else:
                    del self._queues[duration_s]
            self._wake = trio.Event()
            self._next_at = next_at
            with trio.move_on_at(next_at):
                await self._wake.wait()
            if trio.current_time() - next_at > STALLED_S:
                await trio.sleep(CATCH_UP_S)
