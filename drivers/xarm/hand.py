"""The gripper of an xArm: the vendor's gripper on the tool's bus, or the vacuum gripper on the outputs of the tool.

It has a connection of its own to the controller, so that a slow bus delays no setpoint and no stop of the arm. The
wire process and the root's stop channel share ``keep_grip``.

A stop keeps the grip. Fingers that move stop where they are, and all others get no message, because a target at the
measured position would loosen a grip. The vacuum stays on or off.
"""

from __future__ import annotations

import math

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.kit.hand import FULL, UNNAMED
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from .config import XArmConfig
from .control import Control, OpenStream, open_control
from .grippers import FASTEST, GRIPPER, PULSES
from .protocol import GripperRegister, GripperStatus, Register, ToolRegister

ASK_S = 0.3
"""Timeout of a request to the gripper, in seconds. The controller itself waits for the tool's bus."""
READ_EVERY_S, WRITE_EVERY_S = 0.05, 0.04
"""Least time between two readings, and between two targets, in seconds."""
STOPS, SETTLE_S = 5, 0.03
"""How often moving fingers are stopped, and the time that they get to stand, in seconds."""
_SLOWEST = 50

_READINGS: tuple[tuple[Register, bytes, int], ...] = tuple(
    (Register.TOOL_RS485, p.read_gripper(register), register)
    for register in (GripperRegister.STATUS, GripperRegister.ERROR, GripperRegister.POSITION)
)
_VACUUM_READINGS: tuple[tuple[Register, bytes, int], ...] = tuple(
    (Register.TOOL_READ_16, p.read_tool(register), register)
    for register in (ToolRegister.DIGITAL_INPUTS, ToolRegister.DIGITAL_OUTPUTS)
)

NO_ANSWER = "it does not answer"


class XArmHand:
    """The gripper, as the wire process sees it."""

    def __init__(self, config: XArmConfig, clock: Clock, open_stream: OpenStream) -> None:
        self._config, self._clock, self._open_stream = config, clock, open_stream
        self._has_fingers = config.gripper == GRIPPER
        self._readings = _READINGS if self._has_fingers else _VACUUM_READINGS
        self._control: Control | None = None
        self._requests: dict[int, int] = {}  # register of each reading without a reply, by number of the request
        self._request_ns = self._written_ns = 0
        self._last: tuple[float, float] | None = None  # opening and speed of the last command
        self._speed = -1  # the speed that the gripper has
        self.opening = math.nan
        """Percent open; not a number before the first reading."""
        self.stamp_ns = 0
        self.contact = math.nan
        """1 if it holds something, 0 if not."""
        self.fault = ""

    @property
    def commanded(self) -> float | None:
        """The target of the last command since the hand was armed; None without one."""
        return None if self._last is None else self._last[0]

    async def open(self) -> None:
        """Connect, and read the gripper once. Raise ``WireDown`` if it does not answer."""
        self.close()
        self._control = control = await open_control(self._config, self._clock, self._open_stream)
        for register, data, which in self._readings:
            reply = await control.ask(register, data, within_s=ASK_S)
            if reply is None or not self._take(which, reply):
                self.close()
                raise WireDown(
                    f"open: {self._config.gripper} does not answer on the tool of the arm at {self._config.port}. "
                    "Check its cable, or leave gripper= out"
                )
        control.on_reply = self._on_reply

    async def arm(self, permit: Permit) -> None:
        """Power the gripper. That moves nothing. Raise ``WireDown`` if it does not answer."""
        self._last, self._speed = None, -1
        if self._control is None or self.fault:
            await self.open()
        if self._has_fingers:
            for register, value in ((GripperRegister.MODE, 0), (GripperRegister.ENABLE, 1)):
                permit.check()
                reply = await self._live.ask(
                    Register.TOOL_RS485, p.write_gripper(register, value), within_s=ASK_S, permit=permit
                )
                if reply is None or not p.is_written(reply.data):
                    raise WireDown(f"enable: the gripper does not answer {register.name}. Check its cable")

    def read(self, now_ns: int) -> None:
        """Take the replies that have come, and send the next requests. Never waits and never raises."""
        control = self._control
        if control is None:
            return
        try:
            control.take_waiting()
            if control.silent_s(now_ns) > self._config.silent_s:
                self.fault = NO_ANSWER
            if not self._requests and now_ns - self._request_ns >= READ_EVERY_S * NS:
                for register, data, which in self._readings:
                    self._requests[control.send(register, data)] = which
                self._request_ns = now_ns
        except WireDown as down:
            self.fault = str(down)
            self.close()

    def follow(self, opening: float, speed: float, permit: Permit) -> None:
        """Send a target, if it is a new one and the bus has time. A later call sends it otherwise."""
        control, now_ns = self._control, self._clock.now_ns()
        if speed == UNNAMED or control is None or self._last == (opening, speed):
            return
        if now_ns - self._written_ns < WRITE_EVERY_S * NS:
            return
        permit.check()
        if self._has_fingers:
            fast = max(_SLOWEST, round(speed / FULL * FASTEST))
            if fast != self._speed:
                control.send(Register.TOOL_RS485, p.write_gripper(GripperRegister.SPEED, fast))
            target = p.setpoint_pulses(opening / FULL * PULSES)
            control.send(Register.TOOL_RS485, p.write_gripper(GripperRegister.TARGET, target))
            self._speed = fast
        else:
            control.send(Register.TOOL_WRITE_16, p.vacuum(opening < FULL / 2))
        self._last, self._written_ns = (opening, speed), now_ns

    async def keep_grip(self) -> Outcome:
        """Stop moving fingers, and keep the grip of all others. Never raises."""
        if self._control is None:
            return Outcome(False, False, self.fault or "not connected")
        outcome, halted = await keep_grip(self._control, self._config.gripper)
        if halted is not None:
            self._last = (halted / PULSES * FULL, UNNAMED)
        return outcome

    def close(self) -> None:
        if self._control is not None:
            self._control.close()
        self._control = None
        self._requests.clear()

    @property
    def _live(self) -> Control:
        if self._control is None:
            raise WireDown("enable: the gripper is not connected. Call resume()")
        return self._control

    def _on_reply(self, reply: p.Reply) -> None:
        which = self._requests.pop(reply.number, None)
        if which is not None:
            self._take(which, reply)
        elif reply.register == Register.TOOL_RS485 and reply.state & p.INVALID:
            self.fault = NO_ANSWER

    def _take(self, which: int, reply: p.Reply) -> bool:
        """Take the value of a register. Return False if the gripper did not answer."""
        if reply.state & p.INVALID:
            value = None
        elif self._has_fingers:
            value = p.gripper_value(reply.data)
        else:
            value = int.from_bytes(reply.data[:4], "big", signed=True) if len(reply.data) >= 4 else None
        if value is None:
            self.fault = NO_ANSWER
            return False
        match which:
            case GripperRegister.STATUS if self._has_fingers:
                self.contact = float(value & 3 == GripperStatus.GRASPED)
            case GripperRegister.ERROR if self._has_fingers:
                self.fault = f"error {value} ({p.GRIPPER_ERRORS.get(value, 'unknown')})" if value else ""
            case GripperRegister.POSITION:
                self._read_opening(FULL * value / PULSES)
            case ToolRegister.DIGITAL_INPUTS:
                self.contact = float(value & 1)
            case ToolRegister.DIGITAL_OUTPUTS:
                self.fault = ""
                self._read_opening(0.0 if value & 1 else FULL)
        return True

    def _read_opening(self, percent: float) -> None:
        self.opening, self.stamp_ns = min(max(percent, 0.0), FULL), self._clock.now_ns()


async def keep_grip(control: Control, gripper: str) -> tuple[Outcome, int | None]:
    """Stop the fingers if they move.

    Returns:
        The result, and the position in pulses at which moving fingers were stopped; None if they did not move.
    """
    if gripper != GRIPPER:
        # Nothing moves by itself. The valve keeps its position.
        return Outcome(True, True, ""), None
    halted: int | None = None
    written = False
    try:
        for _ in range(STOPS):
            status = await _ask(control, p.read_gripper(GripperRegister.STATUS))
            written = True
            if status is None:
                return Outcome(True, False, NO_ANSWER), halted
            if status & 3 != GripperStatus.MOVES:
                return Outcome(True, True, ""), halted
            position = await _ask(control, p.read_gripper(GripperRegister.POSITION))
            if position is None:
                return Outcome(True, False, NO_ANSWER), halted
            halted = p.stop_pulses(min(max(position, 0), PULSES - 1))
            await control.ask(Register.TOOL_RS485, p.write_gripper(GripperRegister.TARGET, halted), within_s=ASK_S)
            await trio.sleep(SETTLE_S)
        return Outcome(True, True, "the fingers move"), halted
    except WireDown as down:
        return Outcome(written, False, str(down)), halted


async def _ask(control: Control, data: bytes) -> int | None:
    reply = await control.ask(Register.TOOL_RS485, data, within_s=ASK_S)
    return None if reply is None or reply.state & p.INVALID else p.gripper_value(reply.data)
