"""Bases that report their speed on the connection that also carries the stop.

Zero is repeated until the base reports that it stands. A report counts only after the base has taken a
zero, and only from the second one on, because the first may have left before. Zeros do not wait for
slow answers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import trio

from strands_actors.contract.wire import WireDown

from .outcome import Outcome

TIMES = 3
"""Least number of zeros, since a service may drop one when its own queue is full."""

AGAIN_S = 0.05
"""Pause between two zeros."""

LOOK_S = 0.01
"""Period of the check for an open connection."""


class Report(NamedTuple):
    """The report of a base about its motion."""

    stamp_ns: int  # the base's clock
    stands: bool
    speed: str  # for people


class ReportingBase(Protocol):
    """A base as a stop sees it. Every call raises ``WireDown`` if the base cannot be reached."""

    @property
    def is_open(self) -> bool:
        """True if a zero can be written and may be answered."""
        ...

    async def connect(self) -> None:
        """Connect if the connection is not open. Neither ask anything first nor wait for an answer."""
        ...

    def zero(self) -> None:
        """Write a stop now, on any connection that can be written, even after something unreadable was
        received on it."""
        ...

    async def taken(self, within_s: float) -> None:
        """Return when the base has taken everything that was written before the call."""
        ...

    async def next_report(self, within_s: float) -> Report:
        """Return the next report."""
        ...


async def stop_until_it_stands(base: ReportingBase, within_s: float) -> Outcome:
    """Send at least ``TIMES`` zeros, until the base reports that it stands.

    Never raises. If something can be written, the first zero leaves before the first wait.
    """
    stop = _Stop(base)
    stop.send()
    with trio.move_on_after(within_s):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(stop.repeat)
            await stop.confirm(within_s)
            nursery.cancel_scope.cancel()
    return Outcome(stop.sent > 0, stop.acknowledged, stop.detail)


async def stop_by_each(bases: Sequence[ReportingBase], within_s: float) -> Outcome:
    """Stop one base over several links at once, until it reports on one of them that it stands.

    Never raises. On each link that can be written, the first zero leaves before the first wait.
    """
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
        self._since_ns: int | None = None  # stamp of the first report after the acknowledgement

    def send(self) -> None:
        try:
            self._base.zero()
            self.sent += 1
        except WireDown as down:
            self.detail = f"not confirmed: {down}"

    async def repeat(self) -> None:
        """Send zero until cancelled. Connect again if there is no connection."""
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
        """Return when the base reports that it stands."""
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
        report = await self._base.next_report(within_s)
        if self._since_ns is None:
            self._since_ns = report.stamp_ns
        elif report.stamp_ns <= self._since_ns:
            self.detail = "not confirmed: what it reports is old"
        elif not report.stands:
            self.detail = f"not confirmed: it reports speed {report.speed}"
        else:
            self.detail = ""
