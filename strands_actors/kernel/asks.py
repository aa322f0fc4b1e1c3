"""What an asker waits on, and for how long."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import cast

import msgspec
import outcome
import trio

from .messages import Message


class AskTimeout(Exception):
    """No answer before the deadline. What was asked may still have happened: follow with a stop."""


class Unreachable(Exception):
    """The actor is not there, or is gone, perhaps with the question. The text is for users."""


def not_there(address: str) -> Unreachable:
    return Unreachable(f"the {_spoken(address)} is not running")


def went_away(address: str) -> Unreachable:
    return Unreachable(f"the {_spoken(address)} went away, perhaps with what it was asked")


def _spoken(address: str) -> str:
    """Return ``gate of so101`` for ``strands/so101/actor/gate``."""
    host, _, actor = address.partition("/actor/")
    return f"{actor} of {host.rpartition('/')[2]}" if actor else address


class Answer:
    """The slot an ask waits on. The reply may come before the asker has parked."""

    __slots__ = ("_task", "_value", "decode", "done", "expires_at", "to", "way")

    def __init__(self, decode: Callable[[msgspec.Raw], Message | None] | None) -> None:
        self.decode = decode
        self.to = ""
        """The address of another process that was asked."""
        self.way: object = None
        """Over which it was asked, and over which alone an answer counts."""
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


class Deadlines:
    """Asks of one duration expire in the order they were made: a queue per duration, one sweeper
    task. (``trio.fail_after`` around each ask costs twice the ask.)"""

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
        if answer.expires_at < self._next_at:  # else the sweeper looks early enough
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
