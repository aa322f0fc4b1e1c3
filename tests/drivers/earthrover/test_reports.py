"""Test when the rover's reports count as new, and when they prove a standstill. In virtual time, on the twin's
service without sockets."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping
from typing import Any

import msgspec
import pytest
import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.codecs.http_messages import Request, Response
from strands_actors.drivers.common.kit.velocity_base import stop_base
from strands_actors.drivers.common.ports.http_port import HttpPort
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.earthrover import protocol as p
from strands_actors.drivers.earthrover.config import REPORT_OLD_S, EarthRoverConfig
from strands_actors.drivers.earthrover.driver import EarthRover
from strands_actors.drivers.earthrover.robots import TABLES
from strands_actors.drivers.earthrover.stop import STEADY_S, STOP_S, RoverZero
from strands_actors.drivers.earthrover.twin import RoverTwin
from strands_actors.drivers.earthrover.wire import QUIET_S, SILENT_S, EarthRoverWire
from strands_actors.kernel.clock import VirtualClock
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.wire.transport import REACH_MARGIN_S
from tests.drivers.common.memory_port import Permission, virtual


class ServicePort(HttpPort):
    """A connection to the twin's service. ``log`` has the kinds of the accepted requests."""

    def __init__(self, twin: RoverTwin) -> None:
        super().__init__("192.0.2.1", 8000)
        self._twin = twin
        self._answers: dict[int, Response] = {}
        self.log: list[str] = []
        self.silent = False

    @property
    def is_open(self) -> bool:
        return True

    async def open(self) -> None:
        await trio.lowlevel.checkpoint()

    async def ready(self) -> None:
        await trio.lowlevel.checkpoint()

    def send(self, method: str, target: str, body: bytes = b"", **_: Any) -> int:
        answer = self._twin.answer(Request(method, target, {}, body, b""))
        self.log.append(answer.kind)
        self._answers[len(self.log)] = Response(answer.status, {}, answer.body)
        return len(self.log)

    def send_stop(self, method: str, target: str, body: bytes = b"") -> int:
        return self.send(method, target, body)

    async def answer(self, number: int, within_s: float) -> Response:
        await trio.sleep(0.002)
        if self.silent:
            await trio.sleep(min(within_s, 60.0))
            raise WireDown("192.0.2.1:8000: no answer")
        return self._answers.pop(number)


class LatePort(ServicePort):
    """A network between service and rover. The service answers, and the rover receives a command ``late_s``
    later. It never receives commands that were sent before ``loses_until_s``."""

    def __init__(self, twin: RoverTwin, late_s: float) -> None:
        super().__init__(twin)
        self._late_s = late_s
        self._coming: deque[tuple[float, bytes]] = deque()
        self.loses_until_s = 0.0

    def send(self, method: str, target: str, body: bytes = b"", **_: Any) -> int:
        self.pass_time()
        if method != "POST":
            return super().send(method, target, body)
        now_s = trio.current_time()
        self.log.append("safe" if p.is_stop(p.decode_command(body) or {}) else "setpoint")
        self._answers[len(self.log)] = Response(p.OK, {}, b"{}")
        if now_s >= self.loses_until_s:
            self._coming.append((now_s + self._late_s, body))
        return len(self.log)

    def pass_time(self) -> None:
        self._twin.rover.pass_time()
        while self._coming and self._coming[0][0] <= trio.current_time():
            self._twin.answer(Request("POST", p.CONTROL, {}, self._coming.popleft()[1], b""))

    async def moved(self, within_s: float) -> bool:
        """Return True if the rover moves within this time."""
        moved = False
        for _ in range(round(within_s / 0.01)):
            await trio.sleep(0.01)
            self.pass_time()
            moved = moved or self._twin.rover.runs != (0.0, 0.0)
        return moved


class MemoryConfig(EarthRoverConfig, frozen=True):
    """A configuration that opens ports to the test's service."""

    port_of: Any = None

    def open_port(self) -> HttpPort:
        found: HttpPort = self.port_of
        return found


def rover(**table: Any) -> tuple[RoverTwin, ServicePort]:
    twin = RoverTwin({**TABLES.table("earthrover"), **table}, trio.current_time)
    return twin, ServicePort(twin)


def wire_to(port: ServicePort) -> EarthRoverWire:
    config = EarthRover("earthrover", "192.0.2.1", {}).config
    fields: Mapping[str, Any] = {name: getattr(config, name) for name in config.__struct_fields__}
    return EarthRoverWire(MemoryConfig(**fields, port_of=port), VirtualClock())


async def heard(wire: EarthRoverWire, port: ServicePort) -> None:
    """Read the service once, as ``serve`` does ten times a second."""
    answer = await port.ask("GET", p.DATA, within_s=0.3)
    wire._observe(p.decode_data(answer.body))


def test_saf_012_a_repeated_report_is_not_new() -> None:
    async def test() -> None:
        twin, port = rover(report_s=0.5)  # slower than the requests
        wire = wire_to(port)
        await wire.open()
        ages_s = []
        for _ in range(20):
            await trio.sleep(0.1)
            await heard(wire, port)
            seen = await wire.read()
            ages_s.append(trio.current_time() - seen.t_ns / 1e9)
            assert set(seen.stamp_ns) == {seen.t_ns}
        assert 0.35 < max(ages_s) < 0.6 and min(ages_s) < 0.1, "a report is as old as its data"
        twin.set_fault(Fault.STUCK)
        for _ in range(25):
            await trio.sleep(0.1)
            await heard(wire, port)
        old_s = trio.current_time() - (await wire.read()).t_ns / 1e9
        assert old_s > REPORT_OLD_S, "the service answers: it is no lost link, and commands are refused as stale"

    virtual(test)


def test_saf_012_repeated_reports_of_a_lost_rover_are_no_connection() -> None:
    async def test() -> None:
        twin, port = rover()
        twin.set_fault(Fault.STUCK)
        with pytest.raises(WireDown, match="the rover sent no new report for 2 s"):
            await wire_to(port).open()
        assert set(port.log) == {"read"}
        twin.set_fault(Fault.OK)
        await wire_to(port).open()

    virtual(test)


def test_saf_012_a_service_without_reports_is_sent_nothing_and_counts_as_lost() -> None:
    async def test() -> None:
        _, port = rover()
        wire = wire_to(port)
        await wire.open()
        async with trio.open_nursery() as nursery:
            wire._nursery, wire._commands = nursery, port
            await wire.write((0.1, 0.0, 0.0), Permission())
            await trio.sleep(QUIET_S + 0.05)
            with pytest.raises(PermitDenied, match="sent no report for"):
                await wire.write((0.1, 0.0, 0.0), Permission())
        assert port.log.count("setpoint") == 1
        await trio.sleep(SILENT_S)
        with pytest.raises(WireDown, match="no valid report for 1 s"):
            await wire.read()

    virtual(test)


def test_saf_005_a_rover_that_turns_on_the_spot_does_not_stand_though_it_reports_speed_0() -> None:
    async def test() -> None:
        twin, port = rover(ramp_s=4.0, watchdog_s=0.0)
        port.send("POST", p.CONTROL, p.encode_setpoint(0.0, 1.0, 0.0))
        for _ in range(50):
            await trio.sleep(0.1)
            twin.rover.pass_time()
        told = p.decode_data(twin.data())
        assert told.speed == 0 and told.vectors["rpms"] == (-100.0, 100.0, -100.0, 100.0)
        outcome = await stop_base(port, RoverZero(), STOP_S)
        assert outcome.written and outcome.detail.startswith("not confirmed: it reports speed")
        assert (await stop_base(port, RoverZero(), 5.0)).detail == ""
        assert twin.rover.runs == (0.0, 0.0)
        assert port.log[-2:] == ["safe", "read"]

    virtual(test)


@pytest.mark.parametrize("late_s", [0.1, 0.4, 0.8])
@pytest.mark.parametrize("lost_s", [0.0, 0.3])
def test_saf_010_a_stop_is_not_confirmed_before_a_late_command_has_begun(late_s: float, lost_s: float) -> None:
    """The service takes a command at once. The rover receives it later, and some zeros never."""

    async def test() -> None:
        twin, _ = rover(watchdog_s=0.0)
        port = LatePort(twin, late_s)
        assert not await port.moved(1.0)
        for _ in range(3):
            port.send("POST", p.CONTROL, p.encode_setpoint(0.5, 0.0, 0.0))
            await trio.sleep(0.05)
        port.loses_until_s = trio.current_time() + lost_s
        for _ in range(3):  # the stop stays unconfirmed until then
            outcome = await stop_base(port, RoverZero(), STOP_S)
            if not outcome.detail:
                break
        assert outcome.detail == ""
        assert twin.rover.x_m > 0, "the rover carried the command out late"
        assert not await port.moved(2.0)

    virtual(test)


@pytest.mark.parametrize("report_s", [0.05, 0.5, 0.9, 0.98, 1.02, 1.5])
def test_saf_005_a_rover_that_reports_rarely_is_seen_to_stand(report_s: float) -> None:
    async def test() -> None:
        twin, port = rover(report_s=report_s, watchdog_s=0.0)
        port.send("POST", p.CONTROL, p.encode_setpoint(0.5, 0.0, 0.0))
        for _ in range(20):
            await trio.sleep(0.1)
            twin.rover.pass_time()
        outcomes = []
        for _ in range(5):
            outcomes.append(await stop_base(port, RoverZero(), STOP_S))
            await trio.sleep(0.13)
        assert "" in {outcome.detail for outcome in outcomes}

    virtual(test)


def test_a_stop_has_the_time_that_it_takes() -> None:
    timing = EarthRover("earthrover", "192.0.2.1", {}).timing
    assert STEADY_S < STOP_S <= timing.safe_s - REACH_MARGIN_S
    assert StopDeadlines.of(timing.safe_s).own_stop_s > STEADY_S + 0.5, (
        "a tree that ends waits long enough to see the standstill"
    )


@pytest.mark.parametrize(
    ("told", "speed"),
    [({}, 0.0), ({"rpms": []}, 0.0), ({"rpms": [[0, 0, 0, -7, 1.0]]}, 7.0), ({"rpms": [[None, 0, 2.0]]}, 0.0)],
)
def test_missing_wheel_speeds_prove_nothing(told: dict[str, Any], speed: float) -> None:
    body = json.dumps({"timestamp": 1.0, "speed": 0, **told}).encode()
    assert RoverZero().read_motion(body).speed == speed
    assert msgspec.json.decode(RoverZero(1.0).body)["command"]["lamp"] == 1
