"""Stop an RB-Y1. The process that drives the robot uses its open connection, the supervising process (root) a
separate one.

``CancelControl`` ends any motion, and the robot holds its position. If the robot does not answer or
does not stand still, its control manager is disabled. The safe state ``off`` also removes the power
of the motors.

A stop is confirmed only by states whose time advances. A state that repeats an earlier time does
not count.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.grpc import Call, CallFailed, Connection

from . import protocol as p
from .config import RBY1Config
from .protocol import Control, Manager, ManagerOrder, Method, PowerOrder, RobotInfo
from .states import RobotState

T = TypeVar("T")

Order = tuple[Method, bytes]

CANCEL: Order = (Method.CANCEL, b"")
DISABLE: Order = (Method.MANAGER, p.encode_manager_order(ManagerOrder.DISABLE))
POWER_OFF: Order = (Method.POWER, p.encode_order(p.MOTOR_SUPPLY, PowerOrder.OFF))

ANSWER_S = 0.3
"""Timeout for the answer to one order."""
ATTEMPTS = 3
LOOK_S = 0.4
"""How long the robot may take to stand still after an answered order."""
STEADY_S = 0.05
"""The robot must stand still for this long. A command that it received late would show in this time."""
POLL_S = 0.01
STANDING_RAD_S = 0.05
"""A joint below this speed counts as standing still [assumed]."""

LONGEST_S = (ATTEMPTS + 1) * (ANSWER_S + LOOK_S)
"""The longest time of one stop, including the order that is the last resort."""

_BUSY = (Control.EXECUTING, Control.SWITCHING)

Connect = Callable[[], Awaitable[Connection]]


def first_orders(safe_state: SafeState) -> Sequence[Order]:
    """Return the orders with which a stop begins."""
    return (CANCEL, DISABLE, POWER_OFF) if safe_state == SafeState.OFF else (CANCEL,)


class Stop:
    """One stop of the robot, with its attempts.

    Args:
        config: The robot's settings.
        connection: The connection to begin with; None to make one.
        connect: Make another connection when the first is lost or does not answer.
    """

    def __init__(self, config: RBY1Config, connection: Connection | None, connect: Connect) -> None:
        self.connection = connection
        self.silent: list[Connection] = []
        """Connections on which orders were not answered. Nothing is withdrawn there, so that a robot
        that was frozen still finds the orders. The caller closes these connections."""
        self._config = config
        self._connect = connect
        self._written = self._acknowledged = False
        self._moving: Sequence[str] = config.axes
        self._reason = "not connected"
        self._refusal = ""
        self._position: Sequence[float] = ()  # joint positions in the newest state
        self._holds = True  # True if a joint that stands still is also held by its motor
        self._motor_supply: int | None = None  # index of the motors' supply; None until the robot has reported it

    async def run(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Bring the robot to ``safe_state``. A held joint is reported with its position.

        It never raises and takes ``LONGEST_S`` at most.
        """
        self._holds = safe_state != SafeState.OFF
        orders = [first_orders(safe_state)] * ATTEMPTS
        if safe_state not in (SafeState.OFF, SafeState.HOLD):
            orders.append((CANCEL, DISABLE))
        with trio.move_on_after(LONGEST_S):
            for attempt in orders:
                try:
                    if await self._try(attempt):
                        return self._reports(True)
                except WireDown as down:
                    self._reason = str(down)
        return self._reports(False)

    async def _try(self, orders: Sequence[Order]) -> bool:
        """Send the orders of the stop, then check their effect. Raise ``WireDown``."""
        if self.connection is None or not self.connection.is_open:
            self.connection = None
            self.connection = await self._connect()
        connection = self.connection
        # Send all orders before the first wait.
        calls = [connection.ask(method, message) for method, message in orders]
        self._written = True
        if not await self._answered(connection, calls):
            self._reason = "silent"
            # Try one other connection. If the robot answers on neither, a third would not help.
            if not self.silent:
                self.silent.append(connection)
                self.connection = None
            return False
        with trio.move_on_after(LOOK_S):
            if await self._stands(connection, orders):
                return True
        self._reason = self._refusal or self._reason
        return False

    async def _answered(self, connection: Connection, calls: Sequence[Call]) -> bool:
        """Return whether all orders were answered in time. Raise ``WireDown`` if an order was
        refused.

        A refusal does not count when the power is ordered off. The state of the supply shows the
        result, and a robot without power may have nothing to cancel.
        """
        until_s = trio.current_time() + ANSWER_S
        self._refusal = ""
        for call in calls:
            try:
                answer = await connection.answer(call, until_s - trio.current_time())
            except CallFailed as failed:
                self._refusal = self._refusal or str(failed)
                continue
            if answer is None:
                return False
            if refusal := _refusal(answer, call.path):
                self._refusal = self._refusal or f"{call.name}: {refusal}"
        if self._refusal and all(call.path != Method.POWER for call in calls):
            raise WireDown(self._refusal)
        self._acknowledged = True
        return True

    async def _stands(self, connection: Connection, orders: Sequence[Order]) -> bool:
        """Read states until the robot has stood still for ``STEADY_S``. Return False if it executes a
        command, which it has then received after the stop. The next attempt cancels that command."""
        steady_s: float | None = None
        # The time of the previous state, by the robot's clock.
        time_ns: int | None = None
        if POWER_OFF in orders and self._motor_supply is None:
            self._motor_supply = (await _ask(connection, Method.GET_ROBOT_INFO, RobotInfo.decode)).motor_supply
        while True:
            state = await _ask(connection, Method.GET_ROBOT_STATE, RobotState.decode)
            # The first state may be from before the stop.
            fresh = time_ns is not None and state.time_ns != time_ns
            time_ns = state.time_ns
            self._reason = self._trouble(state, orders)
            if state.manager.control == Control.EXECUTING:
                return False
            now_s = trio.current_time()
            if not fresh:
                self._moving, self._reason = self._config.axes, "the robot's states do not change"
            elif self._reason:
                steady_s = None
            elif steady_s is None:
                steady_s = now_s
            elif now_s - steady_s >= STEADY_S:
                return True
            await trio.sleep(POLL_S)

    def _trouble(self, state: RobotState, orders: Sequence[Order]) -> str:
        """Return how the robot's state differs from what was ordered; empty if it does not differ."""
        rows = zip(self._config.axes, self._config.ids, strict=True)
        self._position, count = state.position, len(state.velocity)
        speeds = {axis: abs(state.velocity[index]) if index < count else math.inf for axis, index in rows}
        self._moving = [axis for axis, rad_s in speeds.items() if rad_s >= STANDING_RAD_S]
        if state.manager.control in _BUSY:
            self._moving = self._config.axes
            return f"its controller is {p.name_of(Control, state.manager.control)}"
        if DISABLE in orders and state.manager.state == Manager.ENABLED:
            self._moving = self._config.axes
            return "the control manager is still enabled"
        if POWER_OFF in orders and not state.is_off(self._motor_supply):
            self._moving = self._config.axes
            return f"its {p.MOTOR_SUPPLY} supply is not reported as off"
        return "moves" if self._moving else ""

    def _held_position(self, joint: int) -> float | None:
        """Return the position at which a joint at rest is held, in rad."""
        return self._position[joint] if self._holds and joint < len(self._position) else None

    def _reports(self, safe: bool) -> tuple[MotorReport, ...]:
        """Return a report per joint.

        Args:
            safe: True if every joint is safe. If False, a joint is reported as safe only if it stood still
                while others moved.
        """
        stood, reason = self._acknowledged and bool(self._moving), self._reason or "not seen at rest"
        rows = zip(self._config.axes, self._config.ids, strict=True)
        return tuple(
            MotorReport(axis, number, self._written, self._acknowledged, True, target=self._held_position(number))
            if safe or (stood and axis not in self._moving)
            else MotorReport(axis, number, self._written, self._acknowledged, False, reason)
            for axis, number in rows
        )


async def _ask(connection: Connection, method: Method, decode: Callable[[bytes], T]) -> T:
    """Send a request and return the robot's decoded answer. Raise ``WireDown``."""
    answer = await connection.unary(method, b"", LOOK_S)
    try:
        return decode(answer)
    except MalformedFrame as malformed:
        raise WireDown(f"{connection.name}: the robot sent an invalid answer ({malformed})") from None


def _refusal(answer: bytes, path: str) -> str:
    """Decode the robot's answer to an order. Return why the order was refused; empty if it was
    accepted."""
    try:
        if reason := p.error_of(answer):
            return reason
        done, reason = p.decode_done(answer) if path == Method.POWER else (p.Done.SUCCESS, "")
        return "" if done == p.Done.SUCCESS else reason or p.name_of(p.Done, done)
    except MalformedFrame as malformed:
        return str(malformed)
