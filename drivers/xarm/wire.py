"""Talk to an xArm's controller from the wire process, over two connections.

One connection carries requests and replies, the other a hundred reports per second. ``read`` only processes
received data. ``open``, ``arm`` and ``make_safe`` may wait, each with a timeout.
"""

from __future__ import annotations

from typing import Any, ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.common.kit.hand import AXIS as HAND
from strands_actors.drivers.common.kit.hand_gates import with_hand
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED, Outcome
from strands_actors.drivers.common.kit.session_wire import SessionWire
from strands_actors.drivers.common.ports.tcp_port import open_tcp
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from .arms import AXES
from .config import XArmConfig
from .control import CONFIRM_S, OpenStream, stop
from .gates import CONDITIONS
from .grippers import HAND_ID
from .hand import XArmHand
from .protocol import Mode, Register, State
from .session import XArmSession, open_session
from .stop_channel import XArmStopChannel

ENABLE_S = 5.0
"""Timeout of the request that enables the motors, as in the vendor's SDK."""
SETTING_S = 1.0
READY_S = 2.0

ERRORS_EVERY_S = 0.05

QUIET_S = 0.05
"""No setpoint is sent after this many seconds without a message from the controller. It would carry it out late."""

HOLD_S = 0.25
"""An arm that is ordered to hold must reach its target within this time, or it is stopped."""

_REFUSED = p.ERROR | p.NOT_READY | p.INVALID


class XArmWire(SessionWire[XArmSession]):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: XArmConfig, clock: Clock, open_stream: OpenStream = open_tcp) -> None:
        self._config = config
        self._clock = clock
        self._open_stream = open_stream
        self._hand = XArmHand(config, clock, open_stream) if config.gripper else None

    async def open(self) -> dict[str, Any]:
        self.close()
        self.session_or_none, facts = await open_session(self._config, self._clock, self._open_stream)
        if self._hand is None:
            return facts
        try:
            await self._hand.open()
        except BaseException:
            self.close()
            raise
        return {**facts, "gripper": self._config.gripper}

    async def arm(self, permit: Permit) -> Observation:
        session = self.session
        await self._ask(session, Register.ERRORS, b"", SETTING_S, permit)
        self._refuse_error(session)
        past = session.past_range()
        if past:
            raise WireDown(
                f"enable: {past} outside its range. Move it back with the vendor's software, then call resume()"
            )
        settings = (
            # Stop first, since a paused arm stores its targets and would jump to the newest one when it continues.
            (Register.SET_STATE, bytes((State.STOPPED,)), SETTING_S),
            (Register.MOTION_ENABLE, bytes((p.ALL_JOINTS, 1)), ENABLE_S),
            (Register.SET_MODE, bytes((Mode.SERVO,)), SETTING_S),
            (Register.SET_STATE, bytes((State.GO,)), SETTING_S),
        )
        for register, data, within_s in settings:
            permit.check()
            await self._ask(session, register, data, within_s, permit)
            if session.control.error_pending:
                await self._ask(session, Register.ERRORS, b"", SETTING_S, permit)
                self._refuse_error(session)
        await self._until_movable(session, permit)
        position = session.within_range(session.report.position_rad)
        reply = await self._ask(session, Register.SERVO_JOINT, p.servo_data(position, hold=True), SETTING_S, permit)
        if reply.state & _REFUSED:
            raise WireDown(
                f"enable: the controller refuses the arm's position as target (status 0x{reply.state:02x}). "
                "Restart it"
            )
        session.target = position
        if self._hand is not None:
            await self._hand.arm(permit)
        return self._observation(session)

    @property
    def prompt(self) -> bool:
        return True

    async def read(self) -> Observation:
        session = self.session
        now_ns = self._clock.now_ns()
        session.take_waiting(now_ns)
        self._check_alive(session, now_ns)
        control = session.control
        since_s = (now_ns - session.errors_requested_ns) / NS
        news = control.error_pending != bool(control.errors[0])
        # If possible, request the errors only when all earlier requests are answered, since some controllers answer
        # only one request each time they read the connection. Do not wait longer than one more period for that.
        if since_s >= (ERRORS_EVERY_S if control.idle else 2 * ERRORS_EVERY_S) or (news and control.idle):
            control.send(Register.ERRORS)
            session.errors_requested_ns = now_ns
        if self._hand is not None:
            self._hand.read(now_ns)
        return self._observation(session)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self.session
        now_ns = self._clock.now_ns()
        session.take_waiting(now_ns)
        silent_s = session.silent_s(now_ns)
        if silent_s > QUIET_S:
            raise PermitDenied(f"the controller has sent nothing for {silent_s * 1e3:.0f} ms")
        target = session.within_range(values[: p.JOINTS])
        permit.check()
        session.control.send(Register.SERVO_JOINT, p.servo_data(target))
        session.target = target
        if self._hand is not None:
            self._hand.follow(values[p.JOINTS], values[p.JOINTS + 1], permit)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        hand = self._hand
        if hand is None or self.session_or_none is None:
            return await self._make_arm_safe(safe_state)
        grip = NOT_CONNECTED

        async def keep_grip() -> None:
            nonlocal grip
            grip = await hand.keep_grip()

        async with trio.open_nursery() as nursery:
            # The new task runs only when the arm waits for its first answer, so the arm is stopped first.
            nursery.start_soon(keep_grip)
            reports = await self._make_arm_safe(safe_state)
        if len(reports) > p.JOINTS and not grip.written:
            return reports  # The stop channel has reached the gripper, too.
        kept = hand.opening if hand.commanded is None else hand.commanded
        return (*reports[: p.JOINTS], *grip.reports((HAND,), (HAND_ID,), (kept,)))

    async def _make_arm_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session = self.session_or_none
        if session is None:
            return NOT_CONNECTED.reports(self._config.axes)
        self.hold_failed = ""
        if safe_state == SafeState.HOLD:
            outcome = await self._hold(session) if session.target else Outcome(False, False, "it was stopped")
            if not outcome.detail:
                return outcome.reports(AXES, targets=session.target)
            self.hold_failed = self._reason_not_movable(session) or outcome.detail
        session.target = ()
        outcome = await stop(session.control)
        # Nothing can be sent on this connection any more, but the arm may still be reachable on a new one.
        if not outcome.written:
            return await self.reach(safe_state)
        return outcome.reports(AXES)

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the arm on the lost connection, if bytes can still be sent there, and on a new connection.

        If only the direction from the controller is interrupted, no new connection can be made, but the stop on the
        old one still arrives.
        """
        self._close_if_answered()
        sent = self._tell_to_stop()
        channel = XArmStopChannel(self._config, (), self._clock, self._open_stream)
        try:
            reports = await channel.make_safe(safe_state)
        finally:
            self._close_if_answered()
        if sent and not any(report.written for report in reports):
            return Outcome(True, False, reports[0].detail).reports(self._config.axes)
        return reports

    def _tell_to_stop(self) -> bool:
        """Send a stop without waiting for its reply. Return True if it could be sent."""
        session = self.session_or_none
        if session is None:
            return False
        try:
            session.stops.add(session.control.send(Register.SET_STATE, bytes((State.STOPPED,))))
        except WireDown:
            return False
        session.target = ()
        return True

    def _close_if_answered(self) -> None:
        """Close the old connection after a reply has shown that the controller received the stop there.

        Some controllers serve one client only, and accept the new connection only after that. Without this reply
        the old connection stays open, because it may be the only way to the controller.
        """
        session = self.session_or_none
        if session is None:
            return
        try:
            session.control.take_waiting()
        except WireDown:
            session.close()
            return
        if session.control.state_set in session.stops:
            session.close()

    def close(self) -> None:
        if self._hand is not None:
            self._hand.close()
        if self.session_or_none is not None:
            self.session_or_none.close()
        self.session_or_none = None

    # -- steps of arming

    async def _ask(
        self, session: XArmSession, register: Register, data: bytes, within_s: float, permit: Permit
    ) -> p.Reply:
        reply = await session.control.ask(register, data, within_s=within_s, permit=permit)
        if reply is None:
            raise WireDown(f"enable: the controller did not answer {register.name} within {within_s:g} s. Check it")
        return reply

    def _refuse_error(self, session: XArmSession) -> None:
        error = session.control.errors[0]
        if error:
            raise WireDown(
                f"enable: the controller reports error {p.error_words(error)}. "
                "Clear it at the arm, then call resume()"
            )

    async def _until_movable(self, session: XArmSession, permit: Permit) -> None:
        """Wait for a report with servo mode and a state in which the arm follows targets. Raise ``WireDown`` if
        no such report comes in time."""
        session.take_waiting(self._clock.now_ns())
        with trio.move_on_after(READY_S):
            while await session.next_report(self._clock, READY_S):
                permit.check()
                if session.movable:
                    return
        report = session.report
        raise WireDown(
            f"enable: the arm is in state {report.state}, mode {report.mode} after {READY_S:g} s, not ready in "
            "servo mode. Check it with the vendor's software"
        )

    # -- the hold of the arm

    async def _hold(self, session: XArmSession) -> Outcome:
        """Send the last target again, and check that the arm reaches it. Never raises."""
        acknowledged = False
        try:
            data = p.servo_data(session.target, hold=True)
            reply = await session.control.ask(Register.SERVO_JOINT, data, within_s=CONFIRM_S)
            acknowledged = reply is not None
            if reply is None or reply.state & _REFUSED:
                return Outcome(True, acknowledged, "the controller refuses the target")
            session.take_waiting(self._clock.now_ns())
            with trio.move_on_after(HOLD_S):
                while await session.next_report(self._clock, HOLD_S):
                    if session.movable and session.is_at(session.target):
                        return Outcome(True, True, "")
        except WireDown as down:
            return Outcome(True, acknowledged, str(down))
        return Outcome(True, acknowledged, "the arm did not reach the target that it must hold")

    def _reason_not_movable(self, session: XArmSession) -> str:
        """Return why the arm cannot follow targets, by the newest report; empty if it can."""
        observation, now_ns = self._observation(session), self._clock.now_ns()
        refusals = (condition.check(observation, now_ns) for condition in CONDITIONS)
        return next((refusal.reason for refusal in refusals if refusal is not None), "")

    # -- checks and observations for the methods above

    def _check_alive(self, session: XArmSession, now_ns: int) -> None:
        silent_s = session.silent_s(now_ns)
        if silent_s > self._config.silent_s:
            raise WireDown(
                f"read: {self._config.robot} has sent nothing for {silent_s * 1e3:.0f} ms. "
                "Check the controller and its network"
            )

    def _observation(self, session: XArmSession) -> Observation:
        report, (error, warning) = session.report, session.control.errors
        low, high = zip(*session.arm_type.range_rad, strict=True)
        observation = Observation(
            t_ns=session.stamp_ns,
            position=report.position_rad,
            stamp_ns=(session.stamp_ns,) * p.JOINTS,
            sensors={
                "torque_nm": report.torque_nm,
                "tcp_xyz_m": tuple(mm / 1e3 for mm in report.pose_mm_rad[:3]),
                "tcp_rpy_rad": report.pose_mm_rad[3:],
                "state": (float(report.state),),
                "mode": (float(report.mode),),
                "error": (float(error),),
                "warning": (float(warning),),
                "speed_limit_rad_s": (session.limit_rad_s,),
                "range_low_rad": low,
                "range_high_rad": high,
            },
            faults={"controller": f"error {p.error_words(error)}"} if error else {},
        )
        return observation if self._hand is None else with_hand(observation, self._hand)
