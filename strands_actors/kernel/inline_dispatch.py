"""Whose turn it is: who runs in a node's loop also runs the idle actors that it has just given
mail.

One pass of trio's scheduler costs more than most messages (4 us and a system call against 1). A setpoint goes
through three actors and a keepalive through four, 500 times a second; so a message to an actor that waits does
not wake the actor's own task, but is handled in its place, at the end of the turn in which it was sent: when the
sender's handler has returned. What an actor sees is the same: one message at a time, in the same order, never
from within a handler; and what it raises is its own.

Only handlers that wait for nothing are run so: synchronous ones, and what an actor calls prompt. A
turn gives way after ``LONGEST_NS`` or ``BURST``: who still has mail is woken.
"""

from __future__ import annotations

import types
from collections import deque
from collections.abc import Coroutine, Generator
from typing import Any, Protocol

from .clock import Clock

LONGEST_NS = 400_000
BURST = 1024
"""Messages of one actor, or actors, in one go: in virtual time no nanosecond passes meanwhile."""


class Worker(Protocol):
    """An actor as a turn sees it."""

    def help(self, until_ns: int) -> bool:
        """Handle what is there, until ``until_ns``; whether that was all. Raises nothing of the
        actor's own."""
        ...

    def wake(self) -> None:
        """Its own task shall do it."""
        ...


class InlineDispatch:
    """Of one node. Enter it around what gives actors mail; nothing may be awaited inside."""

    __slots__ = ("_clock", "_depth", "_ready")

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._depth = 0
        self._ready: deque[Worker] = deque()

    def offer(self, worker: Worker) -> bool:
        """Return whether it will be helped, or woken, at the end of this turn. False: there is no
        turn."""
        if self._depth:
            self._ready.append(worker)
            return True
        return False

    def __enter__(self) -> None:
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        try:
            if self._depth == 1 and self._ready:
                self._help()
        finally:
            self._depth -= 1

    def _help(self) -> None:
        ready, now_ns = self._ready, self._clock.now_ns
        until_ns = now_ns() + LONGEST_NS
        try:
            for _ in range(BURST):
                if not ready:
                    return
                worker = ready.popleft()
                if not worker.help(until_ns):
                    worker.wake()
                if now_ns() > until_ns:
                    return
        finally:
            self.wake_all()

    def wake_all(self) -> None:
        while self._ready:
            self._ready.popleft().wake()

    @types.coroutine
    def of(self, handler: Coroutine[Any, Any, Any]) -> Generator[Any, Any, Any]:
        """Await ``handler``: what it runs in one go is a turn. When it waits, who got mail is woken
        instead of helped: among them may be who ends its wait, which trio does not know of yet."""
        resume, value = handler.send, None
        while True:
            self._depth += 1
            try:
                trap = resume(value)
            except StopIteration as done:
                if self._depth == 1 and self._ready:
                    self._help()
                return done.value
            finally:
                if self._depth == 1:
                    self.wake_all()
                self._depth -= 1
            try:
                resume, value = handler.send, (yield trap)
            except GeneratorExit:
                handler.close()
                raise
            except BaseException as error:
                resume, value = handler.throw, error
