"""The wire of the rover, in the wire process: commands on one connection, reports on another, stops on a
third.

A command is written when the previous one has been answered. Without an answer within half a second the
link ends. No stop is confirmed while an answer is pending, because that command may still be carried out.
So zero follows the command on its own connection, which keeps their order, and then leaves on a new one.
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
from strands_actors.drivers.earthrover.refusals import EarthRoverCode
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from . import protocol as p
from .config import REPORT_OLD_S, EarthRoverConfig
from .stop import STOP_S, RoverZero

COMMAND_S = 0.5
"""Longest time for the answer to a command. After that the link counts as lost."""

WAIT_S = 0.2
"""How long a command waits for the answer to the previous one."""

OWED_S = 0.03
"""How long a stop waits for the answer to a command that was just sent."""

REPORT_S = 0.3
"""Longest time for one ``GET /data``."""

ARM_S = 1.0

SILENT_S = 1.0
"""The link counts as lost after so long without an answer."""

QUIET_S = 0.5
"""No command is written after so long without data from the service."""

LOOK_S = 0.02
"""Period of polling for the second report."""


class EarthRoverWire(Wire):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: EarthRoverConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._stop: HttpPort | None = None
        self._commands: HttpPort | None = None
        self._nursery: trio.Nursery | None = None  # the one of ``serve``
        self._owed: trio.Event | None = None  # of an unanswered command; set by its answer
        self._given_up = False  # True after a missing answer: this wire writes no more commands
        self._told: tuple[float, ...] = (0.0, 0.0, 0.0)  # the last command, in axis order
        self._seen: Observation | None = None
        self._heard_ns = 0  # when the service last answered with data
        self._stamp_s = math.nan  # of the newest report, on the rover's clock
        self._problem = "it has told nothing yet"

    async def open(self) -> dict[str, Any]:
        """Connect, and wait for two different reports. For a rover that is gone, the service repeats the last
        one."""
        self.close()
        port = self._port()
        first = await self._ask(port, self._config.timeout_s)
        self._told = (0.0, 0.0, 1.0 if first.lamp > 0 else 0.0)
        self._observe(first)
        with trio.move_on_after(REPORT_OLD_S):
            while True:
                await trio.sleep(LOOK_S)
                data = await self._ask(port, REPORT_OLD_S)
                self._observe(data)
                if data.stamp_s != first.stamp_s:
                    return {"service": f"http://{port.name}", "watchdog_assumed_s": 3.0}
        raise WireDown(
            f"{port.name}: GET {p.DATA}: the rover's report stands still for {REPORT_OLD_S:g} s. "
            "Look at the rover and its network"
        )

    async def _ask(self, port: HttpPort, within_s: float) -> p.Data:
        """Request one report. Raise ``WireDown``."""
        try:
            answer = await port.ask("GET", p.DATA, within_s=within_s)
            return self._data(answer.status, answer.body)
        except MalformedFrame as malformed:
            raise WireDown(f"{port.name}: GET {p.DATA}: {malformed}. Check what is served there") from None

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
        answer = await port.answer(port.send("POST", p.CONTROL, p.encode_stop(self._told[2])), ARM_S)
        if answer.status != p.OK:
            raise WireDown(f"arm: zero is answered with status {answer.status}. Look at the SDK process")
        return await self.read()

    async def read(self) -> Observation:
        await trio.lowlevel.checkpoint()
        seen = self._seen
        if seen is None or self._silent_s() > SILENT_S:
            raise WireDown(f"read: no data for {SILENT_S:g} s ({self._problem}). Check the SDK process")
        return msgspec.structs.replace(seen, position=self._told)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        nursery, port = self._nursery, self._commands
        if nursery is None or port is None or self._given_up:
            raise WireDown("write: not connected, or no answer. Open it anew")
        if not await self._answered(WAIT_S):
            raise PermitDenied("the command before has not been answered")
        await port.ready()
        linear, angular, lamp = (axis.sign * value for axis, value in zip(self._config.axes, values, strict=True))
        body = p.encode_setpoint(linear, angular, lamp)
        if self._silent_s() > QUIET_S:
            raise PermitDenied(f"the service has told nothing for {self._silent_s() * 1e3:.0f} ms")
        permit.check()
        number = port.send("POST", p.CONTROL, body)
        self._told, self._owed = values, trio.Event()
        nursery.start_soon(self._take_answer, port, number, self._owed)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        zero = self._zero()
        is_open = self._stop is not None and self._stop.is_open
        written = (self._owed is not None or not is_open) and self._follow(zero)
        return await self._stop_base(zero, written)

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop on a new connection, without waiting any longer for a pending answer.

        Before that, zero leaves on the open connections, in any state. If a command is pending, it leaves
        after that command only, because a service that continues reads its connections in any order.
        """
        zero = self._zero()
        written = self._follow(zero)
        waits, self._owed = self._owed is not None, None
        if self._stop is not None:
            if not (waits and written):
                written = _send_zero(self._stop, zero) or written
            self._stop.close_in_order()
        return await self._stop_base(zero, written)

    def _zero(self) -> RoverZero:
        lamp = self._told[2]
        self._told = (0.0, 0.0, lamp)
        return RoverZero(lamp)

    async def _stop_base(self, zero: RoverZero, written: bool) -> tuple[MotorReport, ...]:
        """Repeat zero until the rover stands. ``written`` is True if zero has left on a connection that is
        not used any more."""
        try:
            if self._owed is not None and not await self._answered(OWED_S):
                self._port().close_in_order()  # The service reads a new connection after those that wait.
            outcome = await stop_base(
                self._port(), zero, STOP_S, lambda: self._owed is not None and not self._given_up
            )
        except WireDown as down:
            outcome = Outcome(False, False, str(down))
        outcome = outcome._replace(written=outcome.written or written)
        return outcome.reports(*names_of(self._config.axes), self._told)

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        client = self._config.open_port()
        try:
            body = msgspec.json.encode({"text": arguments["text"]})
            answer = await client.ask("POST", p.SPEAK, body, within_s=p.SPEAK_S, permit=permit)
        finally:
            client.close()
        if answer.status != p.OK:
            return Refused(EarthRoverCode.SERVICE, f"the SDK process answers status {answer.status}")
        return {"spoken": arguments["text"]}

    def close(self) -> None:
        for port in (self._stop, self._commands):
            if port is not None:
                port.close()
        self._owed = self._seen = None

    # -- background tasks

    async def _take_answer(self, port: HttpPort, number: int, owed: trio.Event) -> None:
        """Wait for the answer to a command. If it does not come, send zero after the command, permit no
        further one, and raise ``WireDown``."""
        answered = False
        try:
            with trio.move_on_after(COMMAND_S):
                answer = await port.answer(number, math.inf)
                answered = True
                if answer.status != p.OK:
                    raise WireDown(f"write: the answer is status {answer.status}. Look at the SDK process")
                return
            raise WireDown(f"write: no answer within {COMMAND_S * 1e3:.0f} ms. Check the SDK process")
        finally:
            if answered:
                self._owed = None
                owed.set()
            else:
                self._given_up = True
                self._follow(RoverZero(self._told[2]))

    async def _answered(self, within_s: float) -> bool:
        """Wait until no answer is pending. Return False after ``within_s`` seconds."""
        with trio.move_on_after(within_s):
            while self._owed is not None:
                await self._owed.wait()
        return self._owed is None

    def _follow(self, zero: RoverZero) -> bool:
        """Send zero on the connection of the commands, after the pending one. Return True if it was sent."""
        return self._commands is not None and _send_zero(self._commands, zero)

    async def _hear(self, reports: HttpPort) -> None:
        try:
            self._observe(await self._ask(reports, REPORT_S))
        except WireDown as problem:
            self._problem = str(problem)  # ``read`` reports it if it lasts.

    def _data(self, status: int, body: bytes) -> p.Data:
        if status != p.OK:
            raise MalformedFrame(f"status {status}")
        return p.decode_data(body)

    def _observe(self, data: p.Data) -> None:
        """Keep a report. Its age counts from its first arrival, since the service repeats the last one until
        the next."""
        now_ns = self._heard_ns = self._clock.now_ns()
        if self._seen is not None and data.stamp_s == self._stamp_s:
            now_ns = self._seen.t_ns
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
        self._seen = Observation(
            t_ns=now_ns,
            position=self._told,
            stamp_ns=(now_ns,) * len(self._told),
            sensors={**sensors, **data.vectors},
        )

    def _silent_s(self) -> float:
        return (self._clock.now_ns() - self._heard_ns) / NS

    def _port(self) -> HttpPort:
        self._stop = self._stop or self._config.open_port()
        return self._stop


def _send_zero(port: HttpPort, zero: RoverZero) -> bool:
    try:
        port.send_stop("POST", zero.target, zero.body)
    except WireDown:
        return False  # It is closed. The stop uses another connection.
    return True
