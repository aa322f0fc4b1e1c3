"""Bring a T1 to a safe state. The process that drives the robot and the supervising process (root) use this code.

``hold``  the robot stands, and its arms are held at their present positions
``stop``  as ``hold``, then the robot's own controller gets the upper body back
``damp``  the robot stands, then sinks to the floor in damping mode

The request ``Move(0, 0, 0)`` makes the robot stand. Without it the robot keeps its last twist.

A request is done when the robot answers it with status 0, or reports a mode that shows its effect.
"""

from __future__ import annotations

import math
from contextlib import aclosing, suppress

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.kernel.clock import NS

from . import rpc
from .config import CONTROL_S
from .link import AGAIN_S, Link, Order
from .robots import Model
from .rpc import NEVER_WALKS, STANDS, Mode

TICK_S = 0.002
TRIES = 3
"""Number of unanswered ``Move(0, 0, 0)`` requests after which the upper body is handed back anyway."""
AT_MOST_S = 1.0
"""Longest duration of a stop. A robot that receives our requests has answered by then."""
HOLD_S = 0.05
"""Shortest duration of a hold. One datagram may be lost, five are not."""
WAIT_S = 0.1
"""How long handing back waits for a first state, which shows where to hold."""
FRESH_S = 0.2
"""Age up to which a position may be held."""
MODE_S = 0.05
"""Period of asking for the mode during a hold, the same as the wire's while it sends commands."""
STILL_RAD_S = 0.3
"""A faster joint is not at rest [assumed]. A slower one may move, too: a measured speed shows no more
than this."""
REST_RAD = 0.01
"""A joint rests when it stays within this distance of one place for ``HOLD_S`` [assumed].

At the kp of a hold this distance corresponds to 0.6 N m, by which legs that come to a halt may shake an arm. The
place need not be the target: an arm that hangs below its target sinks once more when it is held where it
was, and then rests. A joint that still turns at ``STILL_RAD_S`` covers 0.015 rad in this time, without
getting far from any target.
"""


async def bring_down(link: Link, safe_state: SafeState, arms: bool | None = None) -> tuple[MotorReport, ...]:
    """Bring the robot to a safe state. The first message is sent before anything is waited for. Never raises.

    Args:
        link: The DDS connection to use.
        safe_state: ``hold``, ``stop`` or ``damp``.
        arms: True if the host commands the arms, False if it does not, None if this is unknown.
    """
    procedure = _StopProcedure(link, safe_state, arms)
    procedure.step(link.clock.now_ns())
    link.listen()
    async with aclosing(link.clock.ticks(TICK_S)) as ticks:
        async for now_ns in ticks:
            link.poll()
            procedure.step(now_ns)
            if procedure.done or now_ns - procedure.began_ns > AT_MOST_S * NS:
                break
    return procedure.reports()


class _StopProcedure:
    def __init__(self, link: Link, safe_state: SafeState, arms: bool | None) -> None:
        self.began_ns = link.clock.now_ns()
        self._link = link
        self._safe_state = safe_state
        self._arms = arms
        self._zero = Order(link.calls, rpc.Api.MOVE, rpc.ZERO)
        self._last = {
            SafeState.STOP: Order(link.calls, rpc.Api.UPPER_BODY, rpc.upper_body(False)),
            SafeState.DAMP: Order(link.calls, rpc.Api.CHANGE_MODE, rpc.change_mode(Mode.DAMPING)),
        }.get(SafeState(safe_state))
        self._modes = Order(link.calls, rpc.Api.GET_MODE)
        # The mode that the robot has reported since this stop began; None before the first report.
        self._mode: Mode | None = None
        self._requested_ns = 0
        self._holds: tuple[float, ...] = ()
        # When the last and the first hold frame were sent, ns; 0 if none was sent.
        self._held_ns = self._first_ns = 0
        joints = len(link.model.joints)
        # For each joint, the position at which it rests. ``_since_ns`` has the time since which it rests there.
        self._places = [math.nan] * joints
        self._since_ns = [0] * joints

    # -- step by step

    def step(self, now_ns: int) -> None:
        """Send the messages and requests of the stop that are due now."""
        self._zero.step(now_ns)
        if self._may_go_on(now_ns) and self._last is not None:
            self._last.step(now_ns)
        elif self._may_hold:
            self._hold(now_ns)
        self._ask_mode(now_ns)
        self._watch()

    def _ask_mode(self, now_ns: int) -> None:
        """Request the robot's mode once. Repeat the request while the robot refuses another
        request of this stop, or while the arms are held."""
        answer = self._modes.answer
        if self._modes.done and answer is not None:
            with suppress(MalformedFrame):
                self._mode = rpc.mode_of(answer.body)
            refused = any(order.answer and not order.done for order in (self._zero, self._last) if order)
            pause_s = MODE_S if self._first_ns else AGAIN_S if refused else math.inf
            if now_ns - self._requested_ns >= pause_s * NS:
                self._modes = Order(self._link.calls, rpc.Api.GET_MODE)
        if not self._modes.tries:
            self._requested_ns = now_ns
        self._modes.step(now_ns)

    def _may_go_on(self, now_ns: int) -> bool:
        """Return True if the final request of the stop may be sent. The request for damping mode may
        be sent at once. The upper body is handed back only when the robot stands and its arms are held."""
        if self._last is None:
            return False
        if self._safe_state == SafeState.DAMP or self._last.tries:
            return True
        stands = self._stands or self._zero.tries >= TRIES
        arms_held = (
            self._arms is False
            or self._first_ns
            or now_ns - self.began_ns > WAIT_S * NS
            or self._mode is Mode.CUSTOM
        )
        return bool(stands and arms_held)

    @property
    def _may_hold(self) -> bool:
        """Return True if hold frames for the arms may be sent. In custom mode such a frame would
        take the torque from the legs. If it is unknown whether the host commands the arms, the mode
        must be reported first."""
        if self._arms is None:
            return self._mode in STANDS
        return self._arms and self._mode is not Mode.CUSTOM

    def _hold(self, now_ns: int) -> None:
        """Hold the arms at their present positions. This starts only after the base was commanded
        to stop."""
        if not self._zero.written or now_ns - self._held_ns < CONTROL_S * NS:
            return
        # Take the present positions anew until the first frame is sent. Old positions would swing the arms back.
        if not self._first_ns:
            self._holds = self._present_positions(now_ns)
        if self._holds and self._link.send_hold(self._holds):
            self._held_ns = now_ns
            self._first_ns = self._first_ns or now_ns

    def _present_positions(self, now_ns: int) -> tuple[float, ...]:
        """Return the present position of each joint; empty if any position is missing or old. In
        that case no frame is sent, and the arms keep their last goal."""
        link = self._link
        state = link.state
        if state is None or now_ns - link.state_ns > FRESH_S * NS:
            return ()
        positions = link.of_arms(state.q)
        return () if any(map(math.isnan, positions)) else positions

    def _watch(self) -> None:
        """Store for each joint the position at which it rests, and since when. Only states after
        the first hold frame count."""
        state, state_ns = self._link.state, self._link.state_ns
        if state is None or not self._first_ns or state_ns <= self._first_ns:
            return
        for index, rad in enumerate(self._link.of_arms(state.q)):
            # The comparison is also true for NaN: the joint is not reported, or this is its first state.
            if not abs(rad - self._places[index]) <= REST_RAD:
                self._places[index], self._since_ns[index] = rad, state_ns

    # -- results

    @property
    def _stands(self) -> bool:
        return self._zero.done or self._mode in NEVER_WALKS

    @property
    def _reason(self) -> str:
        """Return the request that is not confirmed, with the reason; empty if all requests are
        confirmed."""
        if not self._stands:
            return f"Move(0, 0, 0): {self._zero.error}"
        last = self._last
        if last is None or last.done or (last.answer is not None and self._mode is Mode.DAMPING):
            return ""
        request = "damping mode" if self._safe_state == SafeState.DAMP else "handing back the upper body"
        return f"{request}: {last.error}"

    @property
    def done(self) -> bool:
        if self._reason:
            return False
        if self._safe_state != SafeState.HOLD or self._arms is False:
            return True
        long_enough = self._first_ns and self._held_ns - self._first_ns >= HOLD_S * NS
        return bool(long_enough and all(self._still()))

    def _still(self) -> list[bool]:
        """Return for each joint whether it is at rest in the states after the first hold frame. A
        low speed alone is not enough: an arm that ignores the frames and turns slowly has a low
        speed, too."""
        state, state_ns = self._link.state, self._link.state_ns
        if state is None:
            return [False] * len(self._since_ns)
        return [
            # Both comparisons are False for NaN.
            abs(rad_s) <= STILL_RAD_S and 0 < since_ns <= state_ns - HOLD_S * NS
            for rad_s, since_ns in zip(self._link.of_arms(state.dq), self._since_ns, strict=True)
        ]

    def reports(self) -> tuple[MotorReport, ...]:
        orders = [order for order in (self._zero, self._last, self._modes) if order is not None]
        written = bool(self._first_ns) or any(order.written for order in orders)
        answered = any(order.answer is not None for order in orders)
        reason, joints = self._reason, self._link.model.joints
        if reason or self._safe_state != SafeState.HOLD or self._arms is False:
            return tuple(
                MotorReport(joint.key, joint.slot, written, answered, not reason, reason) for joint in joints
            )
        # Only requests to the base were sent. The arms got no frame and keep their last goal.
        if not self._first_ns:
            return unconfirmed(
                self._link.model,
                "the robot receives no commands" if self._holds else "the position is not known",
            )
        return tuple(
            MotorReport(joint.key, joint.slot, True, still, still, "" if still else "the joint still turns", target)
            for joint, still, target in zip(joints, self._still(), self._holds, strict=True)
        )


def unconfirmed(model: Model, reason: str, written: bool = False) -> tuple[MotorReport, ...]:
    return tuple(MotorReport(joint.key, joint.slot, written, False, False, reason) for joint in model.joints)
