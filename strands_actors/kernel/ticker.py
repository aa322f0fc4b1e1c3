"""A ticker that stands back while something else brings its ticks.

A wake-up with nothing to do costs a process more than what is done at most ticks. Where messages
come as often as a ticker ticks, its work can be done along with theirs, and all that is left to it
is to notice that they stay away: it waits for a deadline that each of them moves on, which takes no
system call. When none came for ``LAPSE`` periods it ticks by its timer again.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import aclosing

import trio

from .clock import Clock

LAPSE = 1.5
"""Periods from a tick that was brought to the next of our own, if no other is brought meanwhile."""


class Ticker:
    """Ticks once per ``period_s``, in trio's loop."""

    def __init__(self, clock: Clock, period_s: float) -> None:
        self._clock = clock
        self._period_s = period_s
        self._due_s = 0.0  # by trio's clock: not before then
        self._scope: trio.CancelScope | None = None

    def brought(self) -> None:
        """What is done at a tick has just been done."""
        self._due_s = trio.current_time() + LAPSE * self._period_s
        if self._scope is not None:
            self._scope.deadline = self._due_s

    async def run(self, tick: Callable[[int], None]) -> None:
        """Call ``tick(now_ns)`` until cancelled."""
        async with aclosing(self._clock.ticks(self._period_s)) as ticks:
            async for now_ns in ticks:
                if trio.current_time() >= self._due_s:
                    tick(now_ns)
                while trio.current_time() < self._due_s:
                    with trio.CancelScope(deadline=self._due_s) as self._scope:
                        await trio.sleep_forever()
                self._scope = None
