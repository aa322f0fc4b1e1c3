"""Drive a gripper on the wrist of a UR by the text port of Robotiq's URCap (TCP port 63352).

A line sets fields of the command (``SET POS 255 SPE 100 FOR 50 GTO 1``), or reads one field (``GET POS``). Answers
(``ack``, ``POS 255``) have no line end and no number. They come in the order of the lines [assumed]. If an answer
does not fit its line, the connection counts as lost.

A stop is ``SET GTO 0``: the fingers stop where they are, and the gear keeps an object gripped [assumed]. It does
not set the activation bit, so it never activates a gripper. While an activation moves the fingers, a stop is a
reset.
"""

from __future__ import annotations

import math
import re
from collections import deque

import trio

from strands_actors.contract.wire import MotorReport, Permit, WireDown
from strands_actors.drivers.common.kit.hand import AXIS, FULL, UNNAMED
from strands_actors.drivers.common.ports.exchange import Exchange, numbers
from strands_actors.drivers.common.ports.tcp_port import TcpPort, open_tcp
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p

PORT = 63352

ACKNOWLEDGED = "ack"
POLLED = ("POS", "STA", "FLT", "PRE", "OBJ")
POLL_S = 0.02
"""Pause between two readings of all these fields."""

ANSWER_S = 0.5
"""Timeout of an answer while the gripper is opened or armed."""
CONFIRM_S = 0.25
"""Longest wait for each answer to a stop."""
SILENT_S = 0.3
"""If a line has no answer for this time, the connection counts as lost."""
RESET_S = 1.0
STEP_S = 0.05
LAST_NUMBER = 1 << 30
_BETWEEN = b"\r\n\0 "
"""Bytes that may stand between two answers."""
LONGEST = 64
"""Most bytes that may wait to be decoded. An answer has about 8."""

STOP, RESET = "SET GTO 0", "SET ACT 0 GTO 0"


def percent_of(counts: float) -> float:
    """Convert a position (0 open, 255 closed) to percent open."""
    return FULL * (1.0 - counts / p.TOP)


class UrcapGripper:
    """One connection to the text port, with the newest value of each field that is polled.

    Args:
        stream: The connection.
        number: The number of the gripper in reports.
        clock: The clock.
    """

    def __init__(self, stream: TcpPort, number: int, clock: Clock) -> None:
        self._stream, self._number, self._clock = stream, number, clock
        self._numbers = numbers(LAST_NUMBER)
        self._exchange: Exchange[int, str, int] = Exchange()
        self._order: deque[int] = deque()
        self._pending = b""
        self._fields: dict[str, int] = {}
        self._sent: tuple[int, int, int] | None = None
        self._speed = 0.0
        self._position_ns = 0

    # -- lines and answers

    def _send(self, line: str, answer: str, awaited: bool = True) -> int:
        """Send a line at once, and return the number under which its answer arrives."""
        number = next(self._numbers)
        self._stream.write(f"{line}\n".encode())
        self._exchange.sent(number, answer, self._clock.now_ns(), awaited=awaited)
        self._order.append(number)
        return number

    async def _receive(self) -> None:
        self._pending = (self._pending + await self._stream.read()).lstrip(_BETWEEN)
        self._exchange.received(self._clock.now_ns())
        while self._pending:
            if not self._order:
                raise self._not_understood("no line")
            expected = self._exchange.request(self._order[0]) or ""
            pattern = rb"(ack)" if expected == ACKNOWLEDGED else rb"%s (\d{1,3})" % expected.encode()
            matched = re.match(pattern, self._pending)
            if matched is None:
                if len(self._pending) < LONGEST and f"{expected} ".encode().startswith(self._pending):
                    return
                raise self._not_understood(expected)
            self._pending = self._pending[matched.end() :].lstrip(_BETWEEN)
            self._take(expected, 0 if expected == ACKNOWLEDGED else int(matched[1]))

    def _take(self, expected: str, value: int) -> None:
        sent = self._exchange.take(self._order.popleft(), value)
        if expected == ACKNOWLEDGED or sent is None:
            return
        if expected == "POS":
            before_s = (sent.sent_ns - self._position_ns) / NS
            if self._position_ns and before_s > 0:
                self._speed = (percent_of(value) - percent_of(self._fields["POS"])) / before_s
            self._position_ns = sent.sent_ns
        self._fields[expected] = value

    def _not_understood(self, expected: str) -> WireDown:
        shown = self._pending[:LONGEST].decode("ascii", "replace")
        return WireDown(
            f"{self._stream.name}: the gripper's port sent {shown!r} for {expected}. Check that Robotiq's URCap is "
            "installed, and that it has a gripper"
        )

    async def _get(self, field: str, within_s: float = ANSWER_S) -> int:
        """Return the present value of a field. Raise ``WireDown`` if there is no answer in time."""
        return await self._answer(self._send(f"GET {field}", field), within_s)

    async def _answer(self, number: int, within_s: float) -> int:
        try:
            value = await self._exchange.answer(number, within_s, self._receive)
        finally:
            self._exchange.forget(number)
        if value is None:
            raise self._silent(within_s)
        return value

    def _silent(self, silent_s: float) -> WireDown:
        return WireDown(
            f"{self._stream.name}: the gripper's port did not answer for {silent_s * 1e3:.0f} ms. "
            "Check the gripper and its URCap on the pendant"
        )

    # -- for the wire of the arm

    async def open(self) -> None:
        """Read all fields once. Raise ``WireDown`` if the gripper does not answer."""
        for field in POLLED:
            await self._get(field)

    async def serve(self) -> None:
        """Read the fields again and again until cancelled. Raise ``WireDown`` if the connection is lost."""
        while True:
            for field in POLLED:
                await self._get(field, math.inf)
            await trio.sleep(POLL_S)

    def check_alive(self) -> None:
        """Raise ``WireDown`` if the gripper has not answered for too long."""
        silent_s = self._exchange.silent_s(self._clock.now_ns())
        if silent_s > SILENT_S:
            raise self._silent(silent_s)

    async def arm(self, permit: Permit, may_activate: bool) -> None:
        """Bring the gripper into a state in which it follows commands. It moves only to be activated.

        Args:
            permit: The right to write.
            may_activate: False: refuse a gripper that is not activated.

        Raises:
            WireDown: The gripper could not be activated.
        """
        if self._fields["FLT"] == p.RELEASING:
            raise WireDown("arming: the gripper's automatic release is running. Wait until it has ended")
        await self._write(STOP, permit)
        if self._fields["STA"] == p.Activation.ACTIVE and self._fields["FLT"] < p.MAJOR:
            return
        if not may_activate:
            raise WireDown(
                f"arming: the gripper is not activated (gSTA {self._fields['STA']}, "
                f"{p.fault_words(self._fields['FLT'])}), and gripper_activate= is False. Activating moves its "
                "fingers through their whole stroke"
            )
        await self._write(RESET, permit)
        await self._until_activation(p.Activation.RESET, RESET_S, permit)
        await self._write("SET ACT 1", permit)
        await self._until_activation(p.Activation.ACTIVE, p.ACTIVATION_S, permit)

    async def _write(self, line: str, permit: Permit) -> None:
        permit.check()
        await self._answer(self._send(line, ACKNOWLEDGED), ANSWER_S)

    async def _until_activation(self, activation: p.Activation, within_s: float, permit: Permit) -> None:
        with trio.move_on_after(within_s):
            while await self._get("STA") != activation:
                permit.check()
                await trio.sleep(STEP_S)
            await self._get("POS")
            await self._get("FLT")
            return
        raise WireDown(
            f"arming: the gripper did not reach gSTA {activation:d} within {within_s:g} s (gSTA "
            f"{self._fields['STA']}). Free its fingers and check its power supply"
        )

    def write(self, target: tuple[float, ...]) -> None:
        """Send a target: opening, speed and force in percent. The permit was checked just before.

        A target that was sent last is not sent again, since the gripper keeps its goal.
        """
        opening, speed, force = target
        if UNNAMED in (speed, force):
            return
        counts = (p.counts_of(1.0 - opening / FULL), p.counts_of(speed / FULL), p.counts_of(force / FULL))
        if counts != self._sent:
            self._send("SET POS {} SPE {} FOR {} GTO 1".format(*counts), ACKNOWLEDGED, awaited=False)
            self._sent = counts

    def begin_stop(self) -> int | None:
        """Send the stop at once. Return the number for ``confirm``, or None if the connection is lost."""
        self._sent = None
        line = RESET if self._fields.get("STA") == p.Activation.ACTIVATING else STOP
        try:
            return self._send(line, ACKNOWLEDGED)
        except WireDown:
            return None

    async def confirm(self, number: int | None) -> MotorReport:
        """Wait until the gripper repeats the stop. Never raises.

        Args:
            number: The result of ``begin_stop``.
        """
        if number is None:
            return self.report(False, False, f"{self._stream.name}: the connection is lost")
        acknowledged = False
        try:
            await self._answer(number, CONFIRM_S)
            acknowledged = True
            if await self._get("STA", CONFIRM_S) == p.Activation.ACTIVATING:
                await self._answer(self._send(RESET, ACKNOWLEDGED), CONFIRM_S)
                if await self._get("STA", CONFIRM_S) == p.Activation.ACTIVATING:
                    return self.report(True, True, "activating: the fingers move")
            if await self._get("GTO", CONFIRM_S):
                return self.report(True, True, "the fingers still move to their target")
            if await self._get("FLT", CONFIRM_S) == p.RELEASING:
                return self.report(True, True, "automatic release is running: the fingers open")
        except WireDown as down:
            return self.report(True, acknowledged, str(down))
        return self.report(True, True, "")

    def report(self, written: bool, acknowledged: bool, detail: str) -> MotorReport:
        return MotorReport(AXIS, self._number, written, acknowledged, not detail, detail)

    # -- readings

    @property
    def position(self) -> float:
        """The opening in percent."""
        return percent_of(self._fields["POS"])

    @property
    def speed(self) -> float:
        """Percent per second, from the last two positions."""
        return self._speed

    @property
    def stamp_ns(self) -> int:
        """The time at which the position was requested."""
        return self._position_ns

    def sensors(self) -> dict[str, tuple[float, ...]]:
        """Return the state of activation, the fault, and whether the fingers have met an object.

        The contact is NaN while it is unknown: the fingers move, or have not yet received the last target.
        """
        fields = self._fields
        is_valid = self._sent is not None and fields["PRE"] == self._sent[0]
        return {
            "gripper_activation": (float(fields["STA"]),),
            "gripper_fault": (float(fields["FLT"]),),
            "gripper_contact": (p.CONTACTS[p.Contact(fields["OBJ"] & 3)] if is_valid else math.nan,),
        }

    def fault(self) -> str:
        """Return the present fault in words. It is empty without a fault."""
        return p.fault_words(self._fields["FLT"]) if self._fields["FLT"] else ""

    def close(self) -> None:
        self._exchange.clear()
        self._stream.close()


async def open_gripper(host: str, number: int, clock: Clock) -> UrcapGripper:
    """Connect to the text port and read the gripper. Raise ``WireDown`` if that fails."""
    gripper = UrcapGripper(await open_tcp(host, PORT), number, clock)
    try:
        await gripper.open()
    except BaseException:
        gripper.close()
        raise
    return gripper


async def stop_gripper(host: str, number: int, clock: Clock) -> MotorReport:
    """Stop the gripper over a new connection. Never raises."""
    try:
        stream = await open_tcp(host, PORT)
    except WireDown as down:
        return MotorReport(AXIS, number, False, False, False, str(down))
    gripper = UrcapGripper(stream, number, clock)
    try:
        return await gripper.confirm(gripper.begin_stop())
    finally:
        stream.close_in_order()


__all__ = ["PORT", "UrcapGripper", "open_gripper", "stop_gripper"]
