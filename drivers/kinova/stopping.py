"""Stop an arm, on one or several connections to its base.

The wire process uses its own connection. The supervising process (root) uses every connection that it has.

The steps of one stop:

1. Send ``Stop`` on every connection, before waiting for any response. Repeat ``Stop`` until it is answered.
2. If no connection answers within ``ANEW_S``, open another session and send ``Stop`` there, too.
3. If the base refuses ``Stop`` and no connection shows the arm at rest, send ``ApplyEmergencyStop``. The
   base is in fault after that.

Only new feedback can show that a joint stands still: feedback with a repeated frame number is no measurement. An
arm at rest counts as safe only if the base has acknowledged the stop, or is in fault. ``RestWatch`` decides which
joints are at rest.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from typing import NamedTuple

import trio

from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED
from strands_actors.drivers.common.kit.rest_watch import Rest, RestWatch

from .client import KortexClient, Refusal
from .protocol import JOINTS, ArmState, Call, Feedback, Fingers, Frame

AGAIN_S = 0.025
"""A stop command without a response is sent again after this time."""

LOOK_S = 0.2
"""Timeout of one request for feedback."""

POLL_S = 0.01
ANEW_S = 0.1
"""If no connection has acknowledged the stop within this time, another connection is opened."""

STANDS_S = {Call.STOP: 0.8, Call.APPLY_EMERGENCY_STOP: 0.4}
"""Longest time in seconds until the arm stands still after each command. From top speed it takes 0.2 s [assumed].
The sum of both is below the time limit of a stop."""

STANDING_DEG_S = 0.5
"""A joint below this speed counts as standing still [assumed], because measured speeds are noisy."""

STEADY_S = 0.05
"""A joint must stand still for this long. A joint that changes direction, or has not started yet, also has the
speed zero for a moment."""

FRAME_NUMBERS = 1 << 32
"""The base numbers its cycles modulo this."""


class StopAttempt:
    """The stop on one connection, with the result observed on this connection."""

    def __init__(self, client: KortexClient) -> None:
        self.client = client
        self._orders: list[int] = []  # Request numbers of the sent stop commands.
        self.written = self.refused = self.acknowledged = False
        self.feedback: Feedback | None = None  # The newest feedback since the stop command was answered.
        self._first_frame = 0
        self.watch = RestWatch(JOINTS, STEADY_S)
        self.received_s = 0.0  # Time at which the newest feedback was received.
        self.is_over = False  # True once ``follow`` has ended for the last stop command.
        self.detail = "silent"

    @property
    def answered(self) -> bool:
        """True if the base has answered the stop, and so has read everything that was sent before it."""
        return self.acknowledged or self.refused

    @property
    def will_stay_at_rest(self) -> bool:
        """True if an arm at rest will stay at rest: the base has acknowledged the stop, or is in fault."""
        in_fault = self.feedback is not None and self.feedback.arm_state == ArmState.IN_FAULT
        return self.acknowledged or in_fault

    @property
    def confirmed(self) -> bool:
        return self.will_stay_at_rest and not self.watch.unsteady

    def order(self, call: Call) -> None:
        """Send the stop command ``call``. Never raises."""
        try:
            self.is_over = False
            self._orders = [self.client.ask(call)]
            self.written = True
        except WireDown as down:
            self.detail = str(down)

    async def follow(self, call: Call) -> None:
        """Wait until the feedback shows the arm at rest, or the base refuses the stop command. Never raises."""
        if not self.written:
            return
        try:
            while (answer := await self._answer_to_order()) is None:
                self._orders.append(self.client.ask(call))
            if answer.error:
                self.refused, self.detail = True, Refusal(call, answer.sub_error).text
            else:
                self.acknowledged = True
            await self._look()
            while self.will_stay_at_rest and not self.confirmed:
                self.detail = self._detail
                await trio.sleep(POLL_S)
                await self._look()
        except WireDown as down:
            self.detail = str(down)
        finally:
            for number in self._orders:
                self.client.forget(number)

    @property
    def _detail(self) -> str:
        if self.watch.repeats:
            return "its feedback stands still"
        return "no new feedback" if self.watch.rest is Rest.NOTHING_SINCE else "moves"

    async def _answer_to_order(self) -> Frame | None:
        """Wait briefly for the response to any stop command that was sent. Return it, or None."""
        await self.client.listen(self._orders[-1], AGAIN_S)
        return next((answer for number in self._orders if (answer := self.client.pop_response(number))), None)

    async def _look(self) -> None:
        number = self.client.ask(Call.REFRESH_FEEDBACK)
        answer = await self.client.answer(number, LOOK_S)
        self.client.forget(number)
        if answer is None or answer.error:
            return
        try:
            feedback = Feedback.decode(answer.payload)
        except MalformedFrame as error:
            self.detail = str(error)
            return
        if len(feedback.actuators) != JOINTS:
            return
        is_first, now_s = self.feedback is None, trio.current_time()
        if is_first:
            self._first_frame = feedback.frame
        moving = [i for i, joint in enumerate(feedback.actuators) if abs(joint.velocity_deg_s) >= STANDING_DEG_S]
        if self.watch.report((feedback.frame - self._first_frame) % FRAME_NUMBERS, moving, now_s) or is_first:
            self.feedback, self.received_s = feedback, now_s


OpenSession = Callable[[], Awaitable[KortexClient]]
"""Opens another session. Raises ``WireDown``."""


class StopResult(NamedTuple):
    """The result of a stop.

    Attributes:
        reports: A report per joint. A joint is safe if it was measured at rest after the stop command.
        fingers: The newest measurement of a gripper since the stop; None without one.
        silent: The clients on which the base has not answered the stop. Earlier requests may still wait there.
    """

    reports: tuple[MotorReport, ...]
    silent: tuple[KortexClient, ...]
    fingers: Fingers | None


async def stop_arm(
    axes: Sequence[str],
    clients: Sequence[KortexClient],
    open_session: OpenSession | None = None,
    last_positions: Sequence[float] = (),
) -> StopResult:
    """Stop the arm, as described at the top of this module. Never raises.

    Args:
        axes: The names of the joints, in order.
        clients: The connections on which to send the stop.
        open_session: Opens an additional session if ``clients`` do not answer soon. None: use ``clients`` only.
        last_positions: The last joint positions in rad. If given, the report of a safe joint contains its position.
    """
    attempts = [StopAttempt(client) for client in clients]
    await _try(Call.STOP, attempts, open_session)
    if not any(attempt.confirmed for attempt in attempts):
        await _try(Call.APPLY_EMERGENCY_STOP, [attempt for attempt in attempts if attempt.refused])
    silent = tuple(attempt.client for attempt in attempts if not attempt.answered)
    newest = max(attempts, key=lambda attempt: attempt.received_s, default=None)
    fingers = newest.feedback.fingers if newest is not None and newest.feedback is not None else None
    return StopResult(_reports(axes, attempts, last_positions), silent, fingers)


async def _try(call: Call, attempts: list[StopAttempt], open_session: OpenSession | None = None) -> None:
    for attempt in attempts:
        attempt.order(call)
    with trio.move_on_after(STANDS_S[call]):
        async with trio.open_nursery() as nursery:
            for attempt in attempts:
                nursery.start_soon(_follow, attempt, call, attempts, nursery.cancel_scope)
            if open_session is not None:
                nursery.start_soon(_follow_new_session, open_session, attempts, call, nursery.cancel_scope)


async def _follow(
    attempt: StopAttempt, call: Call, attempts: Sequence[StopAttempt], scope: trio.CancelScope
) -> None:
    """Wait for the result of the stop on one connection, and end the whole stop if this was the last result.

    The stop ends once one connection has confirmed it and all others are done. A slow connection is waited for,
    because speeds that are delayed on it could turn the arm again.
    """
    await attempt.follow(call)
    attempt.is_over = True
    if any(each.confirmed for each in attempts) and all(each.is_over or not each.written for each in attempts):
        scope.cancel()


async def _follow_new_session(
    open_session: OpenSession, attempts: list[StopAttempt], call: Call, scope: trio.CancelScope
) -> None:
    if any(attempt.written for attempt in attempts):
        await trio.sleep(ANEW_S)
    if any(attempt.acknowledged for attempt in attempts):
        return
    try:
        attempt = StopAttempt(await open_session())
    except WireDown:
        return  # No additional session. The result is that of the other connections.
    attempts.append(attempt)
    attempt.order(call)
    await _follow(attempt, call, attempts, scope)


def _reports(
    axes: Sequence[str], attempts: Sequence[StopAttempt], last_positions: Sequence[float]
) -> tuple[MotorReport, ...]:
    """Return a report on the stop for each joint, from the connection that has confirmed the stop best."""
    if not attempts:
        return NOT_CONNECTED.reports(axes)
    best = max(attempts, key=lambda attempt: (attempt.confirmed, attempt.will_stay_at_rest, attempt.written))
    stood = best.feedback.unwrapped(last_positions) if best.feedback is not None and last_positions else None
    # If connections disagree, a joint counts as moving if any of the newest readings shows that it moves.
    moving = {
        index for attempt in attempts if attempt.received_s >= best.received_s for index in attempt.watch.unsteady
    }
    reports = []
    for index, axis in enumerate(axes):
        safe = best.will_stay_at_rest and index not in moving
        detail = "" if safe else best.detail
        target = stood[index] if stood is not None and safe else None
        reports.append(MotorReport(axis, index + 1, best.written, best.acknowledged, safe, detail, target))
    return tuple(reports)
