"""Stop a mobile base that reports its speed on the same connection that carries the stop command.

The command "speed zero" is repeated until the base reports that it does not move. A report counts only if it was
made after the base had received this command. The first report that arrives after the base has acknowledged the
command may have been made before, so reports count from the second on. A slow answer does not delay the next
"speed zero".
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import trio

from strands_actors.contract.wire import WireDown

from .outcome import Outcome
from .rest_watch import Rest, RestWatch

TIMES = 3
"""Least number of zeros, since a service may drop one when its own queue is full."""

AGAIN_S = 0.05
"""Pause between two zeros."""

LOOK_S = 0.01
"""Period of the check for an open connection."""


class Report(NamedTuple):
    """One report that a mobile base has sent about its motion, with a time stamp, whether the base stands still,
    and its speed in words."""

    stamp_ns: int  # time of the report, by the base's clock
    stands: bool
    speed: str  # the speed in words, for messages


class ReportingBase(Protocol):
    """The methods of the connection to one mobile base that are needed to stop it. Every call raises ``WireDown``
    if the base cannot be reached."""

    @property
    def is_open(self) -> bool:
        """True if a stop command can be sent and its answer can be received."""
        ...

    async def connect(self) -> None:
        """Connect if the connection is not open. Send no request, and wait for no answer."""
        ...

    def zero(self) -> None:
        """Send the command "speed zero" now. Any open connection will do, even one on which malformed data was
        received."""
        ...

    async def acknowledged(self, within_s: float) -> None:
        """Wait until the base has received everything that was sent before this call."""
        ...

    async def next_report(self, within_s: float) -> Report:
        """Wait for the next report of the base, and return it."""
        ...


async def stop_until_it_stands(base: ReportingBase, within_s: float) -> Outcome:
    """Send the command "speed zero" at least ``TIMES`` times, until the base reports that it does not move.

    Never raises. If a connection is open, the first command leaves before this function waits for anything.
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
    """Stop one base over several connections at once, until it reports on one of them that it does not move.

    Never raises. On each open connection, the first stop command leaves before this function waits for anything.
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
        self._watch = RestWatch()  # gets the reports that came after the base had acknowledged a stop command

    def send(self) -> None:
        try:
            self._base.zero()
            self.sent += 1
        except WireDown as down:
            self.detail = f"not confirmed: {down}"

    async def repeat(self) -> None:
        """Send the command "speed zero" until cancelled. Connect again if there is no connection."""
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
        """Return when the base reports that it does not move."""
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
            await self._base.acknowledged(within_s)
            self.acknowledged = True
            self.detail = "not confirmed: it has reported nothing since"
        report = await self._base.next_report(within_s)
        self._watch.report(report.stamp_ns, moving=[] if report.stands else [0])
        rest = self._watch.rest
        if rest is Rest.MOVES:
            self.detail = f"not confirmed: it reports speed {report.speed}"
        else:
            self.detail = f"not confirmed: {rest.value}" if rest.value else ""
