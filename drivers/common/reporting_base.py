"""Bases that report their speed on the connection on which they are told to stop.

Zero is repeated until the base is seen to stand. What it reports counts only once it has taken a
zero, and from the second report on: the first may have been on its way. Answers may be slow; zeros
do not wait for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import trio

from strands_actors.contract.wire import WireDown

from .outcome import Outcome

TIMES = 3
"""Zeros at least: a service may drop one when its own queue is full."""

AGAIN_S = 0.05
"""Between two zeros."""

LOOK_S = 0.01
"""How often is looked whether there is a connection to hear on."""


class Report(NamedTuple):
    """What a base tells of itself."""

    stamp_ns: int  # the base's clock
    stands: bool
    speed: str  # for people


class ReportingBase(Protocol):
    """Everything raises ``WireDown`` where the base cannot be reached."""

    @property
    def is_open(self) -> bool:
        """Return whether a zero can be written whose answer may come."""
        ...

    async def connect(self) -> None:
        """Connect, if it is not open. Nothing is asked first, and no answer is waited for."""
        ...

    def zero(self) -> None:
        """Tell it to stop, now, on whatever can be written, whatever has come on it."""
        ...

    async def taken(self, within_s: float) -> None:
        """Return when it has taken what was written before the call."""
        ...

    async def next_report(self, within_s: float) -> Report:
        """Return what it reports next."""
        ...


async def stop_until_it_stands(base: ReportingBase, within_s: float) -> Outcome:
    """Send zero, again and again, at least ``TIMES``, until the base is seen to stand. Never
    raises. Where something can be written, the first zero leaves before the first wait."""
    stop = _Stop(base)
    stop.send()
    with trio.move_on_after(within_s):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(stop.repeat)
            await stop.confirm(within_s)
            nursery.cancel_scope.cancel()
    return Outcome(stop.sent > 0, stop.acknowledged, stop.detail)


async def stop_by_each(bases: Sequence[ReportingBase], within_s: float) -> Outcome:
    """Stop one base by several links at once, until it is seen to stand on one of them. Never
    raises. On each that can be written the first zero leaves before the first wait."""
    outcomes: list[Outcome] = []

    async def stop(base: ReportingBase, scope: trio.CancelScope) -> None:
        outcome = await stop_until_it_stands(base, within_s)
        outcomes.append(outcome)
        if not outcome.detail:
            scope.cancel()

    async with trio.open_nursery() as nursery:
        for base in bases:
            nursery.start_soon(stop, base, nursery.cancel_scope)
    return min(outcomes, key=lambda outcome: (bool(outcome.detail), not outcome.acknowledged, not outcome.written))


class _Stop:
    def __init__(self, base: ReportingBase) -> None:
        self._base = base
        self.sent = 0
        self.acknowledged = False
        self.detail = "not confirmed: it has not answered"
        self._since_ns: int | None = None  # of the first report after that

    def send(self) -> None:
        try:
            self._base.zero()
            self.sent += 1
        except WireDown as down:
            self.detail = f"not confirmed: {down}"

    async def repeat(self) -> None:
        """Send zero until cancelled; on a new connection where there is none."""
        pause_s = AGAIN_S if self._base.is_open else 0.0
        while True:
            await trio.sleep(pause_s)
            pause_s = AGAIN_S
            try:
                await self._base.connect()
            except WireDown as down:
                self.detail = f"not confirmed: {down}"
            else:
                self.send()

    async def confirm(self, within_s: float) -> None:
        """Return when the base is seen to stand."""
        while self.detail or self.sent < TIMES:
            if not self.sent or not self._base.is_open:
                await trio.sleep(LOOK_S)
                continue
            try:
                await self._look(within_s)
            except WireDown as down:
                self.detail = f"not confirmed: {down}"
                await trio.sleep(AGAIN_S)

    async def _look(self, within_s: float) -> None:
        if not self.acknowledged:
            await self._base.taken(within_s)
            self.acknowledged = True
            self.detail = "not confirmed: it has reported nothing since"
        told = await self._base.next_report(within_s)
        if self._since_ns is None:
            self._since_ns = told.stamp_ns
        elif told.stamp_ns <= self._since_ns:
            self.detail = "not confirmed: what it reports is old"
        elif not told.stands:
            self.detail = f"not confirmed: it reports speed {told.speed}"
        else:
            self.detail = ""
