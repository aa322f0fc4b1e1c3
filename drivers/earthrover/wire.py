"""Drive the rover from the wire process, over three HTTP connections: for commands, for reports and for stops.

A command is sent when the previous one has been answered. If an answer does not come within half a second, the
link counts as lost. While an answer is pending, no stop is confirmed, because the service may still carry out that
command. So the stop command is sent twice: behind the pending command on its connection, which keeps the order,
and on a new connection.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import aclosing
from typing import Any, ClassVar

import msgspec
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, Wire, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import Outcome, names_of
from strands_actors.drivers.common.kit.velocity_base import stop_base
from strands_actors.drivers.common.ports.http_port import HttpPort
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from . import protocol as p
from . import refusals
from .config import REPORT_OLD_S, EarthRoverConfig
from .stop import STOP_S, RoverZero

COMMAND_S = 0.5
"""Longest time for the answer to a command, in seconds. After that the link counts as lost."""

WAIT_S = 0.2
"""How long a command waits for the answer to the previous command, in seconds."""

PENDING_S = 0.03
"""How long a stop waits for the answer to a command that was just sent."""

REPORT_S = 0.3
"""Longest time for one ``GET /data``."""

ARM_S = 1.0

SILENT_S = 1.0
"""The link counts as lost after this many seconds without a valid report."""

QUIET_S = 0.5
"""No command is sent after this many seconds without a valid report."""

LOOK_S = 0.02
"""Period of polling for the second report."""


class EarthRoverWire(Wire):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: EarthRoverConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._stop: HttpPort | None = None
        self._commands: HttpPort | None = None
        self._nursery: trio.Nursery | None = None  # the nursery of ``serve``; None while it does not run
        # Set when the pending command is answered; None while no answer is pending.
        self._pending: trio.Event | None = None
        # True after an answer did not come: this object then sends no more commands.
        self._unanswered = False
        self._commanded: tuple[float, ...] = (0.0, 0.0, 0.0)  # last command: linear, angular, lamp
        self._observation: Observation | None = None
        self._last_received_ns = 0  # when the service last answered with a valid report
        self._stamp_s = math.nan  # time of the newest report on the rover's clock
        self._problem = "no report has come yet"

    async def open(self) -> dict[str, Any]:
        """Connect, and wait for two different reports. If the rover is gone, the service repeats its last report.
        So one report does not prove that the rover is there."""
        self.close()
        port = self._port()
        first = await self._ask(port, self._config.timeout_s)
        self._commanded = (0.0, 0.0, 1.0 if first.lamp > 0 else 0.0)
        self._observe(first)
        with trio.move_on_after(REPORT_OLD_S):
            while True:
                await trio.sleep(LOOK_S)
                data = await self._ask(port, REPORT_OLD_S)
                self._observe(data)
                if data.stamp_s != first.stamp_s:
                    return {"service": f"http://{port.name}", "watchdog_assumed_s": 3.0}
        raise WireDown(
            f"{port.name}: GET {p.DATA}: the rover sent no new report for {REPORT_OLD_S:g} s. "
            "Check that the rover is switched on and connected"
        )

    async def _ask(self, port: HttpPort, within_s: float) -> p.Data:
        """Request one report. Raise ``WireDown`` if no valid report comes in time."""
        try:
            answer = await port.ask("GET", p.DATA, within_s=within_s)
            return self._data(answer.status, answer.body)
        except MalformedFrame as malformed:
            raise WireDown(
                f"{port.name}: GET {p.DATA}: {malformed}. Check that the SDK process runs at this address"
            ) from None

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        reports = self._config.open_port()
        commands = self._commands = self._config.open_port()
        try:
            async with trio.open_nursery() as nursery:
                await nursery.start(self._port().serve)
                await nursery.start(commands.serve)
                self._nursery = nursery
                task_status.started()
                async with aclosing(self._clock.ticks(1 / self._config.control_hz)) as ticks:
                    async for _ in ticks:
                        await self._hear(reports)
        finally:
            self._nursery = None
            reports.close()

    async def arm(self, permit: Permit) -> Observation:
        port = self._port()
        if not port.is_open:
            await port.open()
        permit.check()
        answer = await port.answer(port.send("POST", p.CONTROL, p.encode_stop(self._commanded[2])), ARM_S)
        if answer.status != p.OK:
            raise WireDown(
                f"arming: the SDK process answered the zero command with HTTP status {answer.status}. Check it"
            )
        return await self.read()

    async def read(self) -> Observation:
        await trio.lowlevel.checkpoint()
        observation = self._observation
        if observation is None or self._silent_s() > SILENT_S:
            raise WireDown(f"read: no valid report for {SILENT_S:g} s ({self._problem}). Check the SDK process")
        return msgspec.structs.replace(observation, position=self._commanded)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        nursery, port = self._nursery, self._commands
        if nursery is None or port is None or self._unanswered:
            raise WireDown(
                "write: there is no connection to the SDK process, or it did not answer a command. Reconnect"
            )
        if not await self._answered(WAIT_S):
            raise PermitDenied("the SDK process has not answered the previous command")
        await port.ready()
        linear, angular, lamp = (axis.sign * value for axis, value in zip(self._config.axes, values, strict=True))
        body = p.encode_setpoint(linear, angular, lamp)
        if self._silent_s() > QUIET_S:
            raise PermitDenied(f"the SDK process sent no report for {self._silent_s() * 1e3:.0f} ms")
        permit.check()
        number = port.send("POST", p.CONTROL, body)
        self._commanded, self._pending = values, trio.Event()
        nursery.start_soon(self._take_answer, port, number, self._pending)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        zero = self._zero()
        is_open = self._stop is not None and self._stop.is_open
        written = (self._pending is not None or not is_open) and self._follow(zero)
        return await self._stop_base(zero, written)

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop on a new connection, without waiting any longer for a pending answer.

        Before that, send the stop command on the open connections. If a command is pending, send it only behind
        that command on the same connection. A service that was frozen may read its connections in any order, so on
        another connection the stop command could be overtaken by the pending command.
        """
        zero = self._zero()
        written = self._follow(zero)
        waits, self._pending = self._pending is not None, None
        if self._stop is not None:
            if not (waits and written):
                written = _send_zero(self._stop, zero) or written
            self._stop.close_in_order()
        return await self._stop_base(zero, written)

    def _zero(self) -> RoverZero:
        lamp = self._commanded[2]
        self._commanded = (0.0, 0.0, lamp)
        return RoverZero(lamp)

    async def _stop_base(self, zero: RoverZero, written: bool) -> tuple[MotorReport, ...]:
        """Repeat the stop command until the rover has stopped. ``written`` is True if the stop command was already
        sent on a connection that is not used any more."""
        try:
            if self._pending is not None and not await self._answered(PENDING_S):
                # The service reads connections in order, so it reads the pending command before the new
                # connection.
                self._port().close_in_order()
            outcome = await stop_base(
                self._port(), zero, STOP_S, lambda: self._pending is not None and not self._unanswered
            )
        except WireDown as down:
            outcome = Outcome(False, False, str(down))
        outcome = outcome._replace(written=outcome.written or written)
        return outcome.reports(*names_of(self._config.axes), self._commanded)

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        client = self._config.open_port()
        try:
            body = msgspec.json.encode({"text": arguments["text"]})
            answer = await client.ask("POST", p.SPEAK, body, within_s=p.SPEAK_S, permit=permit)
        finally:
            client.close()
        if answer.status != p.OK:
            return refusals.service_failed(answer.status)
        return {"spoken": arguments["text"]}

    def close(self) -> None:
        for port in (self._stop, self._commands):
            if port is not None:
                port.close()
        self._pending = self._observation = None

    # -- background tasks

    async def _take_answer(self, port: HttpPort, number: int, answered_event: trio.Event) -> None:
        """Wait for the answer to a command. If it does not come in time, send the stop command on the same
        connection, send no further command, and raise ``WireDown``."""
        answered = False
        try:
            with trio.move_on_after(COMMAND_S):
                answer = await port.answer(number, math.inf)
                answered = True
                if answer.status != p.OK:
                    raise WireDown(f"write: the SDK process answered with HTTP status {answer.status}. Check it")
                return
            raise WireDown(
                f"write: the SDK process did not answer a command within {COMMAND_S * 1e3:.0f} ms. Check it"
            )
        finally:
            if answered:
                self._pending = None
                answered_event.set()
            else:
                self._unanswered = True
                self._follow(RoverZero(self._commanded[2]))

    async def _answered(self, within_s: float) -> bool:
        """Wait until no answer is pending. Return False if one is still pending after ``within_s`` seconds."""
        with trio.move_on_after(within_s):
            while self._pending is not None:
                await self._pending.wait()
        return self._pending is None

    def _follow(self, zero: RoverZero) -> bool:
        """Send the stop command on the connection for commands, behind a pending command. Return True if it was
        sent."""
        return self._commands is not None and _send_zero(self._commands, zero)

    async def _hear(self, reports: HttpPort) -> None:
        try:
            self._observe(await self._ask(reports, REPORT_S))
        except WireDown as problem:
            # One failed request does not matter. ``read`` reports this text if no report comes for ``SILENT_S``.
            self._problem = str(problem)

    def _data(self, status: int, body: bytes) -> p.Data:
        if status != p.OK:
            raise MalformedFrame(f"status {status}")
        return p.decode_data(body)

    def _observe(self, data: p.Data) -> None:
        """Store a report. The service repeats the last report until a new one comes, so the age of a report counts
        from the first time that it arrived."""
        now_ns = self._last_received_ns = self._clock.now_ns()
        if self._observation is not None and data.stamp_s == self._stamp_s:
            now_ns = self._observation.t_ns
        self._stamp_s = data.stamp_s
        readings = {
            "battery_pct": data.battery_pct,
            "signal_level": data.signal_level,
            "speed": data.speed,
            "heading_deg": data.heading_deg,
            "vibration": data.vibration,
            "lamp": data.lamp,
            "report_stamp_s": data.stamp_s,
        }
        sensors: dict[str, tuple[float, ...]] = {
            name: (value,) for name, value in readings.items() if not math.isnan(value)
        }
        sensors["latitude_longitude_deg"] = (data.latitude_deg, data.longitude_deg)
        self._observation = Observation(
            t_ns=now_ns,
            position=self._commanded,
            stamp_ns=(now_ns,) * len(self._commanded),
            sensors={**sensors, **data.vectors},
        )

    def _silent_s(self) -> float:
        return (self._clock.now_ns() - self._last_received_ns) / NS

    def _port(self) -> HttpPort:
        self._stop = self._stop or self._config.open_port()
        return self._stop


def _send_zero(port: HttpPort, zero: RoverZero) -> bool:
    try:
        port.send_stop("POST", zero.target, zero.body)
    except WireDown:
        # The connection is closed, so the stop is sent on another connection.
        return False
    return True
