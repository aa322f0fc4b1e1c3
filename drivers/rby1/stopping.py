"""How an RB-Y1 is stopped: by the wire on its own connection, by the root on one of its own.

``CancelControl`` ends whatever the robot does, and it holds where it is. When that is not answered,
or does not help, the control manager is disabled. ``off`` takes the power of the motors away, too.

What confirms it are states whose own time goes on: one that repeats it counts as none.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.grpc import Call, CallFailed, Connection
from strands_actors.drivers.common.malformed import MalformedFrame

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
"""How long one order waits for its answer."""
ATTEMPTS = 3
LOOK_S = 0.4
"""How long the robot may take to stand, after an order that was answered."""
STEADY_S = 0.05
"""A robot that stands does so for this long: a command that it found late shows meanwhile."""
POLL_S = 0.01
STANDING_RAD_S = 0.05
"""A joint that shows less stands [assumed]."""

LONGEST_S = (ATTEMPTS + 1) * (ANSWER_S + LOOK_S)
"""Of one stop, with the order that is the last resort."""

_BUSY = (Control.EXECUTING, Control.SWITCHING)

Connect = Callable[[], Awaitable[Connection]]


class Stop:
    """One stop. ``connection``: the one to begin with; ``connect`` makes another when it is gone,
    or when nobody answers on it."""

    def __init__(self, config: RBY1Config, connection: Connection | None, connect: Connect) -> None:
        self.connection = connection
        self.silent: list[Connection] = []
        """Connections on which orders were not answered. Nothing is withdrawn there: a robot that
        was frozen finds it. Whoever made the stop closes them."""
        self._config = config
        self._connect = connect
        self._written = self._acknowledged = False
        self._moving: Sequence[str] = config.axes
        self._why = "not connected"
        self._refusal = ""
        self._position: Sequence[float] = ()  # of the newest state
        self._holds = True  # what stands is held there
        self._motor_supply: int | None = None  # its place; None: the robot has not told it

    async def run(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Bring the robot to ``safe_state``. Never raises; takes ``LONGEST_S`` at most. A joint that
        is held is reported with where it stands."""
        self._holds = safe_state != SafeState.OFF
        if safe_state == SafeState.OFF:
            orders: list[Sequence[Order]] = [(CANCEL, DISABLE, POWER_OFF)] * ATTEMPTS
        else:
            orders = [(CANCEL,)] * ATTEMPTS
            if safe_state != SafeState.HOLD:
                orders.append((CANCEL, DISABLE))
        with trio.move_on_after(LONGEST_S):
            for attempt in orders:
                try:
                    if await self._try(attempt):
                        return self._reports(True)
                except WireDown as down:
                    self._why = str(down)
        return self._reports(False)

    async def _try(self, orders: Sequence[Order]) -> bool:
        """Send the orders, then see what becomes of them. Raise ``WireDown``."""
        if self.connection is None or not self.connection.is_open:
            self.connection = None
            self.connection = await self._connect()
        connection = self.connection
        calls = [connection.ask(method, message) for method, message in orders]  # all, before any wait
        self._written = True
        if not await self._answered(connection, calls):
            self._why = "silent"
            if not self.silent:  # another one, once: more would not be answered either
                self.silent.append(connection)
                self.connection = None
            return False
        with trio.move_on_after(LOOK_S):
            if await self._stands(connection, orders):
                return True
        self._why = self._refusal or self._why
        return False

    async def _answered(self, connection: Connection, calls: Sequence[Call]) -> bool:
        """Return whether all orders are answered in time. Raise ``WireDown`` when one is refused;
        but not when the power is ordered off: the state of its supply tells, and a robot without
        power may have nothing to cancel."""
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
        """Look until the robot stands, and does so for a while. A command that runs now was found
        late: it is cancelled by the next attempt."""
        steady_s: float | None = None
        time_ns: int | None = None  # of the state before, by the robot's clock
        if POWER_OFF in orders and self._motor_supply is None:
            self._motor_supply = (await _ask(connection, Method.GET_ROBOT_INFO, RobotInfo.decode)).motor_supply
        while True:
            state = await _ask(connection, Method.GET_ROBOT_STATE, RobotState.decode)
            fresh = time_ns is not None and state.time_ns != time_ns  # the first may be of any time
            time_ns = state.time_ns
            self._why = self._trouble(state, orders)
            if state.manager.control == Control.EXECUTING:
                return False
            now_s = trio.current_time()
            if not fresh:
                self._moving, self._why = self._config.axes, "its states stand still"
            elif self._why:
                steady_s = None
            elif steady_s is None:
                steady_s = now_s
            elif now_s - steady_s >= STEADY_S:
                return True
            await trio.sleep(POLL_S)

    def _trouble(self, state: RobotState, orders: Sequence[Order]) -> str:
        """Return what is not as it was ordered; empty: nothing."""
        rows = zip(self._config.axes, self._config.ids, strict=True)
        self._position, known = state.position, len(state.velocity)
        speeds = {axis: abs(state.velocity[at]) if at < known else math.inf for axis, at in rows}
        self._moving = [axis for axis, rad_s in speeds.items() if rad_s >= STANDING_RAD_S]
        if state.manager.control in _BUSY:
            self._moving = self._config.axes
            return f"its controller is {p.name_of(Control, state.manager.control)}"
        if DISABLE in orders and state.manager.state == Manager.ENABLED:
            self._moving = self._config.axes
            return "its control manager is still enabled"
        if POWER_OFF in orders and not state.is_off(self._motor_supply):
            self._moving = self._config.axes
            return f"its {p.MOTOR_SUPPLY} supply is not known to be off"
        return "moves" if self._moving else ""

    def _held(self, joint: int) -> float | None:
        """Return where a joint that stands is held, in rad."""
        return self._position[joint] if self._holds and joint < len(self._position) else None

    def _reports(self, safe: bool) -> tuple[MotorReport, ...]:
        """``safe``: every joint is. Else those are that were seen to stand beside others that
        moved."""
        stood, why = self._acknowledged and bool(self._moving), self._why or "not seen at rest"
        rows = zip(self._config.axes, self._config.ids, strict=True)
        return tuple(
            MotorReport(axis, number, self._written, self._acknowledged, True, target=self._held(number))
            if safe or (stood and axis not in self._moving)
            else MotorReport(axis, number, self._written, self._acknowledged, False, why)
            for axis, number in rows
        )


async def _ask(connection: Connection, method: Method, decode: Callable[[bytes], T]) -> T:
    """Return what the robot answers. Raise ``WireDown``."""
    answer = await connection.unary(method, b"", LOOK_S)
    try:
        return decode(answer)
    except MalformedFrame as malformed:
        raise WireDown(f"{connection.name}: its answer cannot be understood ({malformed})") from None


def _refusal(answer: bytes, path: str) -> str:
    """Return why the robot did not do it; empty: it did."""
    try:
        if why := p.error_of(answer):
            return why
        done, why = p.decode_done(answer) if path == Method.POWER else (p.Done.SUCCESS, "")
        return "" if done == p.Done.SUCCESS else why or p.name_of(p.Done, done)
    except MalformedFrame as malformed:
        return str(malformed)
