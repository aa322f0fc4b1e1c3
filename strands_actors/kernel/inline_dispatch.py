"""Run idle actors in the turn of the sender, instead of waking a task for each message.

Theory. One pass of trio's scheduler costs more than most messages (4 us and a system call, against 1 us). A
setpoint goes through three actors and a keepalive through four, 500 times a second. So a message to an idle
actor does not wake the actor's task. The dispatcher handles it in that task's place, at the end of the turn in
which it was sent.

* A turn is one uninterrupted run of a handler, or of a receiver of frames. It ends when the handler returns or
  waits.
* An actor cannot see the difference. It handles one message at a time, in the same order, and never from within
  another handler. An exception of the actor stays the actor's own.
* Only handlers that wait for nothing run like this: synchronous ones, and those that the actor calls prompt
  (``Actor.is_prompt``).
* A turn ends after ``LONGEST_NS`` or ``BURST`` actors. Actors that still have messages are woken.
"""

from __future__ import annotations

import types
from collections import deque
from collections.abc import Coroutine, Generator
from typing import Any, Protocol

from .clock import Clock

LONGEST_NS = 400_000
BURST = 1024
"""The most messages of one actor, and the most actors, in one turn. In virtual time no nanosecond passes
meanwhile, so that ``LONGEST_NS`` alone is no limit."""


class Worker(Protocol):
    """An actor with waiting messages, as the dispatcher sees it."""

    def help(self, until_ns: int) -> bool:
        """Handle the waiting messages of this actor until the time ``until_ns``. Return True if no message is
        left.

        An exception of the actor is not raised here.
        """
        ...

    def wake(self) -> None:
        """Wake the actor's own task to handle the messages."""
        ...


class InlineDispatch:
    """The dispatcher of one node (the actors of one process). It runs idle actors that get a message.

    Enter it around code that sends messages to actors, and await nothing inside.
    """

    __slots__ = ("_clock", "_depth", "_ready")

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._depth = 0
        self._ready: deque[Worker] = deque()

    def offer(self, worker: Worker) -> bool:
        """Queue the actor, to run it at the end of the present turn (the uninterrupted run of a handler). Return
        False if no turn runs.
        """
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
        """Await ``handler``. Each part of it that runs without waiting is a turn.

        When the handler starts to wait, actors with messages are woken instead of run here. One of them may end
        this very wait, which trio has not registered yet.
        """
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
