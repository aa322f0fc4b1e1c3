"""The service in the wire process: commands on one connection, what the rover reports on another, stops on a third.

A command is written when the one before has been answered; one that is not answered within half a second ends the
link. As long as an answer is owed no stop is confirmed: what was sent may still be carried out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec
import trio

from strands_actors.drivers.common.http_client import HttpClient
from strands_actors.drivers.common.http_port import HttpPort
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.velocity_base import Outcome, stop_base
from strands_actors.runtime.clock import NS, Clock
from strands_actors.runtime.contract import MotorReport, Observation, Permit, PermitDenied, Wire, WireDown
from strands_actors.runtime.messages import Refused

from . import protocol as p
from .stop import STOP_S, RoverZero, open_port

if TYPE_CHECKING:
    from .driver import EarthRover

COMMAND_S = 0.5
"""Within which a command must be answered, or the link counts as lost."""

WAIT_S = 0.2
"""How long a command waits for the answer to the one before."""

REPORT_S = 0.3
"""How long one ``GET /data`` waits."""

ARM_S = 1.0

SILENT_S = 1.0
"""Without data for so long the link counts as lost."""


class _Command:
    """A command on its way, and its permit: what has begun to leave may be carried out, whatever becomes of us."""

    def __init__(self, permit: Permit) -> None:
        self._permit = permit
        self.left = False
        self.answered = trio.Event()

    def check(self) -> None:
        self._permit.check()
        self.left = True


class EarthRoverWire(Wire):
    interruptible: ClassVar[bool] = True

    def __init__(self, driver: EarthRover, clock: Clock) -> None:
        self._driver = driver
        self._clock = clock
        self._stop: HttpPort | None = None
        self._nursery: trio.Nursery | None = None  # of ``serve``
        self._commands: HttpClient | None = None
        self._command: _Command | None = None  # that has not been answered
        self._told: tuple[float, ...] = (0.0, 0.0, 0.0)  # what the rover was last told, in axis order
        self._seen: Observation | None = None
        self._problem = "it has told nothing yet"

    async def open(self) -> dict[str, Any]:
        self.close()
        driver = self._driver
        port = self._port()
        try:
            answer = await port.ask("GET", p.DATA, within_s=driver.timeout_s)
            data = self._data(answer.status, answer.body)
        except MalformedFrame as malformed:
            raise WireDown(f"{port.name}: GET {p.DATA}: {malformed}. Check what is served there") from None
        self._told = (0.0, 0.0, 1.0 if data.lamp > 0 else 0.0)
        self._observe(data)
        return {"service": f"http://{port.name}", "watchdog_assumed_s": 3.0}

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        url = f"http://{self._port().name}"
        commands, reports = HttpClient(url), HttpClient(url)
        try:
            async with trio.open_nursery() as nursery:
                await nursery.start(self._port().serve)
                self._nursery, self._commands = nursery, commands
                task_status.started()
                async for _ in self._clock.ticks(1 / self._driver.timing.control_hz):
                    await self._hear(reports)
        finally:
            self._nursery = self._commands = None
            with trio.CancelScope(shield=True):
                await commands.aclose()
                await reports.aclose()

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
        if seen is None or self._clock.now_ns() - seen.t_ns > SILENT_S * NS:
            raise WireDown(f"read: no data for {SILENT_S:g} s ({self._problem}). Check the SDK process")
        return msgspec.structs.replace(seen, position=self._told)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        nursery = self._nursery
        if nursery is None:
            raise WireDown("write: not connected. Open it first")
        if self._command is not None:
            with trio.move_on_after(WAIT_S):
                await self._command.answered.wait()
            if self._command is not None:
                raise PermitDenied("the command before has not been answered")
        permit.check()
        linear, angular, lamp = (axis.sign * value for axis, value in zip(self._driver.table, values, strict=True))
        self._command = command = _Command(permit)
        try:
            await nursery.start(self._send, p.encode_setpoint(linear, angular, lamp), command)
        finally:
            if not command.left and self._command is command:
                self._command = None
        self._told = values

    async def make_safe(self, rung: str) -> tuple[MotorReport, ...]:
        lamp = self._told[2]
        self._told = (0.0, 0.0, lamp)
        try:
            outcome = await stop_base(self._port(), RoverZero(lamp), STOP_S, lambda: self._command is not None)
        except WireDown as down:
            outcome = Outcome(False, False, str(down))
        return outcome.reports(self._driver, self._told)

    async def reach(self, rung: str) -> tuple[MotorReport, ...]:
        """As ``make_safe``. The answer that is owed no longer comes: its connection is gone."""
        self._command = None
        return await self.make_safe(rung)

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        client = HttpClient(f"http://{self._port().name}")
        try:
            body = msgspec.json.encode({"text": arguments["text"]})
            answer = await client.post(p.SPEAK, body, self._driver.SERVICES[service].within_s, permit)
        finally:
            with trio.CancelScope(shield=True):
                await client.aclose()
        if answer.status_code != p.OK:
            return Refused("service", f"{service}: the SDK process answers status {answer.status_code}")
        return {"spoken": arguments["text"]}

    def close(self) -> None:
        if self._stop is not None:
            self._stop.close()
        self._command = self._seen = None

    # -- what runs beside the calls

    async def _send(
        self, body: bytes, command: _Command, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED
    ) -> None:
        assert self._commands is not None
        answer = await self._commands.post(p.CONTROL, body, COMMAND_S, command, task_status)
        if self._command is command:
            self._command = None
        command.answered.set()
        if answer.status_code != p.OK:
            raise WireDown(
                f"write: a command is answered with status {answer.status_code}. Look at the SDK process"
            )

    async def _hear(self, reports: HttpClient) -> None:
        try:
            answer = await reports.get(p.DATA, REPORT_S)
            self._observe(self._data(answer.status_code, answer.content))
        except (WireDown, MalformedFrame) as problem:
            self._problem = str(problem)  # ``read`` tells when it lasts

    def _data(self, status: int, body: bytes) -> p.Data:
        if status != p.OK:
            raise MalformedFrame(f"status {status}")
        return p.decode_data(body)

    def _observe(self, data: p.Data) -> None:
        now_ns = self._clock.now_ns()
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

    def _port(self) -> HttpPort:
        self._stop = self._stop or open_port(self._driver)
        return self._stop
