"""Drive an RB-Y1 through its gRPC server. This module runs in the wire process.

One call streams states, another streams commands. Both are read and written without waiting. Only
``open``, ``arm``, ``make_safe`` and a service wait, each with a deadline.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, TypeVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown, all_safe
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED, Outcome
from strands_actors.drivers.common.kit.session_wire import SessionWire
from strands_actors.drivers.common.ports.grpc import OpenStream
from strands_actors.drivers.common.ports.tcp_port import open_tcp
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Refused

from . import protocol as p
from . import refusals
from .config import RBY1Config
from .gates import CONTROLLER, refuse_fault, refuse_pressed
from .protocol import Control, JointOrder, Manager, ManagerOrder, Method, PowerOrder
from .session import RBY1Session, open_session
from .stop_channel import RBY1StopChannel, connect_to_stop
from .stopping import Stop, first_orders

T = TypeVar("T")

QUIET_S = 0.1
"""No setpoint is written after this long without a state: the robot would act on it late."""

ORDER_S = 2.0
"""Timeout for the answer to an order to supplies, servos or control manager."""
POWER_S = 5.0
SERVO_S = 5.0
ENABLE_S = 2.0
"""Timeouts until a state shows the effect of the order to supplies, servos and control manager."""
FRESH_S = 1.0


class RBY1Wire(SessionWire[RBY1Session]):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: RBY1Config, clock: Clock, open_stream: OpenStream = open_tcp) -> None:
        self._config = config
        self._clock = clock
        self._open_stream = open_stream

    async def open(self) -> dict[str, Any]:
        self.close()
        self.session_or_none, facts = await open_session(self._config, self._clock, self._open_stream)
        return facts

    async def arm(self, permit: Permit) -> Observation:
        """Switch on the power supplies, the servos and the control manager, each only if it is off.
        Emergency stop buttons and the control manager's faults are checked first."""
        session = self.session
        await session.next_state(self._clock, FRESH_S)
        self._refuse(session)
        if session.state.manager.control == Control.EXECUTING:
            raise WireDown("arming: another program moves the robot. End that program, then try again")
        if not session.state.powered:
            permit.check()
            await self._order(session, Method.POWER, p.encode_order(p.ALL, PowerOrder.ON))
            await self._until(session, lambda: session.state.powered, "power is not on", POWER_S, permit)
        if not session.ready:
            permit.check()
            await self._order(session, Method.JOINT, p.encode_order(p.ALL, JointOrder.SERVO_ON))
            await self._until(session, lambda: session.ready, "servos are not on", SERVO_S, permit)
        if session.state.manager.state != Manager.ENABLED:
            permit.check()
            await self._manager(session, ManagerOrder.ENABLE)
            await self._until(
                session,
                lambda: session.state.manager.state == Manager.ENABLED,
                "the control manager is not enabled",
                ENABLE_S,
                permit,
            )
        permit.check()
        session.drop_stream()
        session.lost = ""
        return self._observation(session)

    @property
    def prompt(self) -> bool:
        return True

    async def read(self) -> Observation:
        session = self.session
        now_ns = self._clock.now_ns()
        session.take_waiting(now_ns)
        silent_s = session.silent_s(now_ns)
        if silent_s > self._config.silent_s:
            raise WireDown(
                f"read: {self._config.robot} has sent no new state for {silent_s * 1e3:.0f} ms. "
                "Check the robot and its network"
            )
        return self._observation(session)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self.session
        now_ns = self._clock.now_ns()
        session.take_waiting(now_ns)
        if session.lost:
            raise PermitDenied(session.lost)
        silent_s = session.silent_s(now_ns)
        if silent_s > QUIET_S:
            raise PermitDenied(f"the robot has sent no new state for {silent_s * 1e3:.0f} ms")
        message = session.command(values)
        permit.check()
        session.send(message)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the robot on the open connection, or on a new one if it does not answer there.

        If the new connection confirms the stop, commands may still wait on the old one. So the old one is reset,
        which drops them. Some of them may already be on their way, so the robot is then stopped once more.
        """
        session = self.session_or_none
        if session is None:
            return NOT_CONNECTED.reports(self._config.axes, self._config.ids)
        with contextlib.suppress(WireDown):
            session.drop_stream()
        stop = Stop(self._config, session.connection, lambda: connect_to_stop(self._config, self._open_stream))
        try:
            reports = await stop.run(safe_state)
            if stop.connection is not session.connection and all_safe(reports):
                session.connection.close()
                reports = await stop.run(safe_state)
            return reports
        finally:
            for connection in (*stop.silent, *([stop.connection] if stop.connection else [])):
                if connection is not session.connection:
                    connection.close_in_order()

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the robot on the lost connection, if bytes can still be sent there, and on a new connection.

        If only the direction from the robot is interrupted, no new connection can be made, but the orders on the
        old one still arrive. After a confirmed stop the old connection is reset, as in ``make_safe``.
        """
        sent = self._order_on_lost(safe_state)
        channel = RBY1StopChannel(self._config, (), self._clock, self._open_stream)
        try:
            reports = await channel.make_safe(safe_state)
            if sent and all_safe(reports):
                self.close()
                reports = await channel.make_safe(safe_state)
        finally:
            channel.close()
        if sent and not any(report.written for report in reports):
            return Outcome(True, False, reports[0].detail).reports(self._config.axes, self._config.ids)
        return reports

    def _order_on_lost(self, safe_state: SafeState) -> bool:
        """Send the orders of a stop without waiting for their answers. Return True if they could be sent."""
        session = self.session_or_none
        if session is None:
            return False
        try:
            session.drop_stream()
            for method, message in first_orders(safe_state):
                session.connection.ask(method, message)
        except WireDown:
            return False
        return True

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        """Run the service ``reset_fault_control_manager``. The control manager goes from its fault
        state to the state idle. Nothing is energised."""
        session = self.session
        permit.check()
        answer = await self._manager(session, ManagerOrder.RESET_FAULT)
        state = _decoded(p.decode_manager_answer, answer)
        reason = _decoded(p.error_of, answer)
        if reason:
            return refusals.fault_not_reset(reason, state.text)
        if state.state not in (Manager.IDLE, Manager.ENABLED):
            return refusals.fault_remains(state.text)
        return {"control_manager": state.text}

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.connection.close()
        self.session_or_none = None

    # -- arming

    def _refuse(self, session: RBY1Session) -> None:
        """Raise ``WireDown`` if the robot must not be powered now: an emergency stop button is
        pressed, or there is a fault."""
        state = session.state
        refusal = refuse_pressed(state.pressed) or refuse_fault(state.manager.state)
        if refusal is not None:
            raise WireDown(refusal.text)

    async def _order(self, session: RBY1Session, method: Method, message: bytes) -> None:
        answer = await session.connection.unary(method, message, ORDER_S)
        done, reason = _decoded(p.decode_done, answer)
        if done != p.Done.SUCCESS:
            name = method.rpartition("/")[2]
            raise WireDown(
                f"arming: the robot refuses {name}: {reason or p.name_of(p.Done, done)}. "
                "Check the robot, then try again"
            )

    async def _manager(self, session: RBY1Session, order: ManagerOrder) -> bytes:
        return await session.connection.unary(Method.MANAGER, p.encode_manager_order(order), ORDER_S)

    async def _until(
        self, session: RBY1Session, ready: Callable[[], bool], problem: str, within_s: float, permit: Permit
    ) -> None:
        """Read states until ``ready()`` is true. Raise ``WireDown`` after ``within_s``, or if the
        robot must not be powered."""
        with trio.move_on_after(within_s):
            while not ready():
                await session.next_state(self._clock, FRESH_S)
                permit.check()
                self._refuse(session)
        if not ready():
            raise WireDown(f"arming: {problem} after {within_s:g} s. Check the robot, then try again")

    # -- parts

    def _observation(self, session: RBY1Session) -> Observation:
        state, limits = session.state, session.limits
        return Observation(
            t_ns=session.stamp_ns,
            position=session.row(state.position),
            stamp_ns=(session.stamp_ns,) * len(self._config.axes),
            velocity=session.row(state.velocity),
            sensors={
                "torque_nm": session.row(state.torque),
                "temperature_c": session.row(state.temperature),
                "battery_pct": (state.battery_pct,),
                "battery_v": (state.battery_v,),
                "odometry_xy_m": state.odometry[:2],
                "odometry_heading_rad": state.odometry[2:],
                "center_of_mass_m": state.center_of_mass,
                "emergency_stop": (float(state.pressed),),
                "power": (float(state.powered),),
                "joints_ready": (float(session.ready),),
                "control_manager": (float(state.manager.state),),
                "control_state": (float(state.manager.control),),
                "range_low_rad": limits.low,
                "range_high_rad": limits.high,
                "speed_limit_rad_s": limits.speed,
            },
            faults={CONTROLLER: session.lost} if session.lost else {},
        )


def _decoded(decode: Callable[[bytes], T], answer: bytes) -> T:
    """Decode an answer. Raise ``WireDown`` if it is malformed."""
    try:
        return decode(answer)
    except MalformedFrame as malformed:
        raise WireDown(f"the robot sent an invalid answer ({malformed})") from None
