"""Test what the simulated rover shows when a gate of the EarthRover driver is taken out.

The SDK process answers that it has sent a command, whatever the command is. The rover has no answer. So each row
gives a reason, and the test shows what the rover does.
"""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.codecs.http_messages import Request
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.earthrover import protocol as p
from strands_actors.drivers.earthrover.driver import EarthRover
from strands_actors.drivers.earthrover.twin import twin_of
from tests.drivers.without_gates import Row, assert_complete, judge


class Bench:
    """The driver, and the simulated SDK process with its rover, in virtual time."""

    def __init__(self) -> None:
        self.driver: Driver = EarthRover("earthrover", "192.0.2.1", {})
        self.now_s = 100.0
        self.twin = twin_of("earthrover", lambda: self.now_s)
        self.statuses: list[int] = []
        self.fastest = 0.0
        self.stamp_s, self.report_s = -1.0, 0.0
        self.run(0.1)

    def ask(self, method: str, target: str, body: bytes = b"") -> tuple[int, bytes]:
        answer = self.twin.answer(Request(method, target, {}, body, b""))
        return answer.status, answer.body

    def run(self, seconds: float) -> None:
        """Let time pass, and ask for a report 20 times a second. Keep the time at which the newest one came."""
        for _ in range(round(seconds / 0.05)):
            self.now_s += 0.05
            data = p.decode_data(self.ask("GET", p.DATA)[1])
            if data.stamp_s != self.stamp_s:
                self.stamp_s, self.report_s = data.stamp_s, self.now_s
            self.fastest = max(self.fastest, data.speed)

    async def state(self) -> GateState:
        report_ns = round(self.report_s * 1e9)
        still = (0.0,) * len(self.driver.axes)
        seen = Observation(report_ns, still, (report_ns,) * len(still))
        return GateState(round(self.now_s * 1e9), seen, still, report_ns, False)

    async def send(self, values: tuple[float, ...]) -> None:
        status, _ = self.ask("POST", p.CONTROL, p.encode_setpoint(*values))
        self.statuses.append(status)
        self.run(2.0)

    def fault(self) -> str:
        """Return the HTTP status of a command that the SDK process has not accepted."""
        return ", ".join(str(status) for status in self.statuses if status != p.OK)


async def gone(bench: Bench) -> None:
    """Let the rover leave the network: the SDK process repeats its last report."""
    bench.twin.set_fault(Fault.STUCK)
    bench.run(2.2)


ROWS: tuple[Row[Bench], ...] = (
    Row(
        "stale",
        {"linear": 0.5},
        no_fault="the SDK process answers that it has sent the command, also if the rover is gone",
        prepare=gone,
    ),
    Row(
        "past_range",
        {"linear": 1.5},
        no_fault="the SDK process sends any number, and the rover runs at full speed [assumed]",
    ),
)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.gate)
def test_the_rover_shows_no_fault_without_the_gate(row: Row[Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    trio.run(judge, row, bench, monkeypatch)
    assert bench.statuses == [p.OK]
    if row.gate == "past_range":
        assert bench.fastest == 1.0, "it cannot run faster than it can"
    else:
        assert bench.fastest == 0.0, "nothing in the reports shows that the command was lost"


def test_each_gate_has_a_row() -> None:
    assert_complete(Bench().driver, ROWS)
