"""A ticker that pauses while messages do its work.

For most ticks the wake-up costs a process more than the work. If messages come as often as a ticker ticks, the
handler of a message can do the work of the tick, too (``brought``). The ticker then only has to notice that no
message comes. It waits for a deadline that each message moves on, which takes no system call. If no message
comes for ``LAPSE`` periods, the ticker ticks by its timer again.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import aclosing

import trio

from .clock import Clock

LAPSE = 1.5
"""Periods from a message that did the work of a tick to the ticker's own next tick, if no further message
comes."""


class Ticker:
    """Calls a function once per ``period_s``, in trio's loop."""

    def __init__(self, clock: Clock, period_s: float) -> None:
        self._clock = clock
        self._period_s = period_s
        # By trio's clock. The ticker does not tick by itself before this time.
        self._due_s = 0.0
        self._scope: trio.CancelScope | None = None

    def brought(self) -> None:
        """Note that the handler of a message has just done the work of a tick."""
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
