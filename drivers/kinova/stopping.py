"""Stop an arm. The wire uses its own session, the root every session that it has.

The steps of one stop:

1. Send ``Stop`` on every connection, before waiting for any response. Repeat it until it is answered.
2. If no connection answers within ``ANEW_S``, open another session and send it there, too.
3. If the base refuses ``Stop`` and no connection shows the arm at rest, send ``ApplyEmergencyStop``. The
   base is in fault after that.

A joint counts as standing still only by new feedback: a repeated frame number is no measurement. An
arm at rest counts as safe only if the base has acknowledged the order, or is in fault.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Sequence

import trio

from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED

from .client import KortexClient, Refusal
from .protocol import JOINTS, ArmState, Call, Feedback, Frame

AGAIN_S = 0.025
"""An order without a response is sent again after this time."""

LOOK_S = 0.2
"""Timeout of one reading."""

POLL_S = 0.01
ANEW_S = 0.1
"""Another connection is opened after this long without any acknowledgement."""

STANDS_S = {Call.STOP: 0.8, Call.APPLY_EMERGENCY_STOP: 0.4}
"""How long the arm may take to stand still after each order: from top speed 0.2 s [assumed]. Their sum
fits into the time limit of a stop."""

STANDING_DEG_S = 0.5
"""A joint below this speed counts as standing still [assumed], because measured speeds are noisy."""

STEADY_S = 0.05
"""A joint must stand still for this long. One that changes direction, or does not follow the last speed
yet, shows speed zero for a moment."""


class _Way:
    """One connection on which the arm is ordered to stop, and the state observed there."""

    def __init__(self, client: KortexClient) -> None:
        self._client = client
        self._orders: list[int] = []  # numbers of the orders without a response
        self.written = self.refused = self.acknowledged = False
        self.feedback: Feedback | None = None  # read after an answered order
        self._stands_still = False  # the last feedback repeated its frame number
        self._moved_s = [math.inf] * JOINTS  # when each joint was last seen to move
        self.seen_s = 0.0
        self.is_over = False  # ``follow`` has ended for the present order
        self.detail = "silent"

    @property
    def moving(self) -> set[int]:
        """The joints that are not confirmed to stand still."""
        return {at for at, moved_s in enumerate(self._moved_s) if not self.seen_s - moved_s >= STEADY_S}

    @property
    def believed(self) -> bool:
        """Whether an arm that stands still stays so: the base acknowledged the order, or is in fault."""
        in_fault = self.feedback is not None and self.feedback.arm_state == ArmState.IN_FAULT
        return self.acknowledged or in_fault

    @property
    def confirmed(self) -> bool:
        return self.believed and not self.moving

    def order(self, call: Call) -> None:
        """Send the order. Never raises."""
        try:
            self.is_over = False
            self._orders = [self._client.ask(call)]
            self.written = True
        except WireDown as down:
            self.detail = str(down)

    async def follow(self, call: Call) -> None:
        """Wait until the arm stands still or the base refuses. Never raises."""
        if not self.written:
            return
        try:
            while (answer := await self._answer_to_order()) is None:
                self._orders.append(self._client.ask(call))
            if answer.error:
                self.refused, self.detail = True, Refusal(call, answer.sub_error).text
            else:
                self.acknowledged = True
            await self._look()
            while self.believed and not self.confirmed:
                self.detail = self._why
                await trio.sleep(POLL_S)
                await self._look()
        except WireDown as down:
            self.detail = str(down)
        finally:
            for number in self._orders:
                self._client.forget(number)

    @property
    def _why(self) -> str:
        if self.feedback is None:
            return "no feedback"
        return "its feedback stands still" if self._stands_still else "moves"

    async def _answer_to_order(self) -> Frame | None:
        """Return the response to any of the orders, however late it is."""
        await self._client.listen(self._orders[-1], AGAIN_S)
        return next((answer for number in self._orders if (answer := self._client.taken(number))), None)

    async def _look(self) -> None:
        number = self._client.ask(Call.REFRESH_FEEDBACK)
        answer = await self._client.answer(number, LOOK_S)
        self._client.forget(number)
        if answer is None or answer.error:
            return
        try:
            seen = Feedback.decode(answer.payload)
        except MalformedFrame as error:
            self.detail = str(error)
            return
        if len(seen.actuators) != JOINTS:
            return
        first = self.feedback is None
        self._stands_still = self.feedback is not None and seen.frame == self.feedback.frame
        if self._stands_still:
            return  # This measurement is an old one. It does not show that a joint stands still.
        self.feedback, self.seen_s = seen, trio.current_time()
        for at, one in enumerate(seen.actuators):
            if first or abs(one.velocity_deg_s) >= STANDING_DEG_S:
                self._moved_s[at] = self.seen_s


Another = Callable[[], Awaitable[KortexClient]]
"""Opens another session. Raises ``WireDown``."""


async def stop_arm(
    axes: Sequence[str],
    clients: Sequence[KortexClient],
    another: Another | None = None,
    known: Sequence[float] = (),
) -> tuple[MotorReport, ...]:
    """Stop the arm, as described at the top of this module. Never raises.

    Args:
        axes: The joints, in order.
        clients: The connections to use.
        another: Opens one more session when ``clients`` do not answer soon; None if only these may be used.
        known: The last joint positions in rad. With them, a safe joint's report has its position as
            target.

    Returns:
        A report per joint. A joint that was seen to stand still after the order is safe.
    """
    ways = [_Way(client) for client in clients]
    await _try(Call.STOP, ways, another)
    if not any(way.confirmed for way in ways):
        await _try(Call.APPLY_EMERGENCY_STOP, [way for way in ways if way.refused])
    return _reports(axes, ways, known)


async def _try(call: Call, ways: list[_Way], another: Another | None = None) -> None:
    for way in ways:
        way.order(call)
    with trio.move_on_after(STANDS_S[call]):
        async with trio.open_nursery() as nursery:
            for way in ways:
                nursery.start_soon(_follow, way, call, ways, nursery.cancel_scope)
            if another is not None:
                nursery.start_soon(_follow_another, another, ways, call, nursery.cancel_scope)


async def _follow(way: _Way, call: Call, ways: Sequence[_Way], scope: trio.CancelScope) -> None:
    """Follow one way. The first that shows the arm at rest ends the stop, once the other ways have ended,
    too: speeds that are delayed on a slow connection could turn the arm again."""
    await way.follow(call)
    way.is_over = True
    if any(each.confirmed for each in ways) and all(each.is_over or not each.written for each in ways):
        scope.cancel()


async def _follow_another(another: Another, ways: list[_Way], call: Call, scope: trio.CancelScope) -> None:
    if any(way.written for way in ways):
        await trio.sleep(ANEW_S)
    if any(way.acknowledged for way in ways):
        return
    try:
        way = _Way(await another())
    except WireDown:
        return  # The reports of the other ways stand.
    ways.append(way)
    way.order(call)
    await _follow(way, call, ways, scope)


def _reports(axes: Sequence[str], ways: Sequence[_Way], known: Sequence[float]) -> tuple[MotorReport, ...]:
    """Return the reports of the way with the best confirmation."""
    if not ways:
        return NOT_CONNECTED.reports(axes)
    best = max(ways, key=lambda way: (way.confirmed, way.believed, way.written))
    stood = best.feedback.unwrapped(known) if best.feedback is not None and known else None
    # A joint that moves by any of the newest readings is moving.
    moving = {at for way in ways if way.seen_s >= best.seen_s for at in way.moving}
    reports = []
    for at, axis in enumerate(axes):
        safe = best.believed and at not in moving
        detail = "" if safe else best.detail
        target = stood[at] if stood is not None and safe else None
        reports.append(MotorReport(axis, at + 1, best.written, best.acknowledged, safe, detail, target))
    return tuple(reports)
