"""Test a gripper on a serial line: its wire and stop channel in memory, then its whole tree on a pty."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors import Robot
from strands_actors.contract.wire import MotorReport, Observation, WireDown
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.robotiq.driver import Robotiq
from strands_actors.drivers.robotiq.sessions import RtuSession
from strands_actors.drivers.robotiq.stop_channel import RobotiqStopChannel
from strands_actors.drivers.robotiq.twin import twin_of
from strands_actors.drivers.robotiq.wire import RobotiqWire
from strands_actors.kernel.clock import VirtualClock
from strands_actors.testing import WireLog
from tests.answers import pids, until
from tests.drivers.common.memory_port import MemoryPort, Permission, virtual
from tests.drivers.common.twin_process import TwinProcess

PORT = "/dev/ttyUSB0"
BYTE_S = 10 / 115_200
ANSWERS_AFTER_S = 0.004


class Line:
    """A wire on the twin's gripper, over a serial line in memory."""

    def __init__(self, options: dict[str, Any] | None = None, **bench: Any) -> None:
        self.driver = Robotiq("robotiq_2f85", PORT, options or {})
        self.twin = twin_of("robotiq_2f85", trio.current_time, activated=True, **bench)
        self.clock = VirtualClock()
        self.wire = RobotiqWire(self.driver.config, self.clock, open_port=self.open)
        self.ports: list[MemoryPort] = []
        self.written: list[str] = []
        self.busy_until_s = 0.0
        self.collisions = 0
        self.delay_s = ANSWERS_AFTER_S

    def open(self, path: str, baud: int) -> MemoryPort:
        assert (path, baud) == (PORT, self.driver.config.baud)
        session = RtuSession(self.twin, self.driver.config.baud, trio.current_time)

        def peer(data: bytes) -> Iterable[tuple[float, bytes]]:
            now_s = trio.current_time()
            if now_s < self.busy_until_s - 1e-9:  # both ends send at once, so neither is received
                self.collisions += 1
                return
            for exchange in session.receive(data, baud):
                if exchange.kind != "read":
                    self.written.append(exchange.kind)
                for reply in exchange.replies:
                    after_s = self.delay_s + (len(data) + len(reply.data)) * BYTE_S + reply.late_s
                    self.busy_until_s = now_s + after_s
                    yield after_s, reply.data

        self.ports.append(MemoryPort(peer))
        return self.ports[-1]

    async def armed(self) -> Line:
        await self.wire.open()
        await self.wire.arm(Permission())
        self.written.clear()
        return self

    async def go(self, closed: float, speed: float = 1.0) -> None:
        await self.wire.write((closed, speed, 1.0), Permission())

    async def observe_for(self, seconds: float) -> Observation:
        end_s = trio.current_time() + seconds
        while True:
            seen = await self.wire.read()
            if trio.current_time() >= end_s:
                return seen
            await trio.sleep(0.02)


def test_it_opens_arms_and_moves() -> None:
    async def main() -> None:
        line = Line()
        reported = await line.wire.open()
        assert reported["baud"] == 115_200
        await line.wire.arm(Permission())
        await line.go(0.5)
        seen = await line.observe_for(2.0)
        assert seen.position[0] == pytest.approx(0.5, abs=0.01)
        assert line.collisions == 0
        assert list(line.wire.handover()) == [99]

    virtual(main)


def test_saf_005_a_stop_waits_for_the_answer_on_its_way_and_is_read_back() -> None:
    """Both ends share the line. A request during an answer of the gripper is lost."""

    async def main() -> None:
        line = await Line().armed()
        await line.go(0.9, speed=0.0)
        await line.observe_for(0.5)
        with trio.move_on_after(0.001):
            await line.wire.read()  # a stop ends the request before its answer arrives
        began_s = trio.current_time()
        written = len(line.ports[0].written)
        assert await line.wire.make_safe("hold") == (MotorReport("gripper", 9, True, True, True),)
        assert line.ports[0].written[written][0] - began_s < 0.03
        assert line.collisions == 0
        assert line.written == ["setpoint", "safe"]
        held = (await line.observe_for(0.1)).position
        assert (await line.observe_for(1.0)).position == held

    virtual(main)


def test_saf_005_a_stop_without_an_answer_is_written_all_the_same() -> None:
    async def main() -> None:
        line = await Line().armed()
        await line.go(0.9, speed=0.0)
        line.twin.set_fault(Fault.INTERMITTENT)
        line.delay_s = 10.0  # its answers are lost
        with trio.move_on_after(0.01):
            await line.wire.read()
        line.busy_until_s = 0.0
        began_s = trio.current_time()
        written = len(line.ports[0].written)
        (report,) = await line.wire.make_safe("hold")
        assert line.ports[0].written[written][0] - began_s < 0.04
        assert report.written and not report.safe
        assert "safe" in line.written

    virtual(main)


@pytest.mark.parametrize("after_s", [0.07, 0.08, 0.09, 0.1, 0.11, 0.15])
def test_saf_005_a_stop_to_a_silent_gripper_is_written_within_the_bound(after_s: float) -> None:
    """The gripper is read first and then reset. It may have lost power, and a hold would activate it."""

    async def main() -> None:
        line = await Line().armed()
        await line.go(0.9, speed=0.0)
        await line.observe_for(0.5)
        line.twin.set_fault(Fault.HALF_OPEN)
        end_s = trio.current_time() + after_s
        with trio.move_on_at(end_s):
            while True:
                await line.wire.read()
                await trio.sleep(0.005)
        line.busy_until_s = 0.0
        began_s = trio.current_time()
        written = len(line.ports[0].written)
        (report,) = await line.wire.make_safe("hold")
        at_s, frame = next(each for each in line.ports[0].written[written:] if each[1][1] == 0x10)
        assert at_s - began_s < line.driver.bound_s
        assert frame[7] == 0, "rACT is 0: a reset"
        assert report.written and not report.safe

    virtual(main)


def test_saf_005_a_stop_after_a_dip_of_the_supply_activates_nothing() -> None:
    async def main() -> None:
        line = await Line().armed()
        line.twin.set_fault(Fault.OFF)
        await line.observe_for(0.2)
        line.twin.set_fault(Fault.OK)
        line.written.clear()
        assert await line.wire.make_safe("hold") == (MotorReport("gripper", 9, True, True, True),)
        assert line.written == ["safe"]
        assert line.twin.gripper.status().activation == 0

    virtual(main)


def test_a_late_answer_is_not_taken_for_the_next_one() -> None:
    async def main() -> None:
        line = await Line().armed()
        line.delay_s = 0.05
        await line.wire.read()  # the request ends before its answer arrives
        line.delay_s = ANSWERS_AFTER_S
        moved = await line.observe_for(0.5)
        assert moved.stamp_ns[0] > 0
        await line.go(0.5)
        assert (await line.observe_for(2.0)).position[0] == pytest.approx(0.5, abs=0.01)

    virtual(main)


def test_saf_012_a_silent_gripper_is_lost() -> None:
    async def main() -> None:
        line = await Line().armed()
        line.twin.set_fault(Fault.OFF)
        with pytest.raises(WireDown, match="did not answer for"):
            await line.observe_for(3.0)

    virtual(main)


def test_the_stop_channel_uses_the_port_of_the_wire_or_reopens_it() -> None:
    async def main() -> None:
        line = await Line().armed()
        await line.go(0.9, speed=0.0)
        channel = RobotiqStopChannel(line.driver.config, (), line.clock, open_port=line.open)
        line.busy_until_s = 0.0
        (report,) = await channel.make_safe("hold")
        assert report.safe
        assert line.written[-1] == "safe"
        assert len(line.ports) == 2
        (again,) = await channel.make_safe("hold")
        assert again.safe
        assert len(line.ports) == 2  # kept, so that no other process takes it
        channel.close()
        assert line.ports[1].closed

    virtual(main)


@pytest.mark.parametrize(
    ("port", "options", "says"),
    [
        (PORT, {"tcp_port": 502}, "a serial device, so tcp_port has no meaning"),
        ("192.0.2.10", {"baud": 9600}, "an address, so baud has no meaning"),
        (PORT, {"baud": 12345}, "baud is 12345. Use one of 2400"),
    ],
)
def test_options_of_the_other_kind_of_port_are_refused(port: str, options: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        Robotiq("robotiq_2f85", port, options)


# -- the whole tree


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[TwinProcess]:
    options = {"serial": True, "activation_s": 0.2, "baud": 57_600}
    with TwinProcess(tmp_path, "robotiq_2f85", "robotiq", options=options) as process:
        yield process


def test_saf_003_a_dead_wire_leaves_a_gripper_that_holds(twin: TwinProcess) -> None:
    log = WireLog(twin.log_path)
    with Robot("robotiq_2f85", mode="real", port=twin.port, baud_rate=57_600) as gripper:
        assert gripper.send_action({"gripper": 0.9, "speed": 0.0})["status"] == "success"
        until(lambda: bool(log.host("setpoint")), "it moves")
        killed_ns = time.monotonic_ns()
        os.kill(pids(gripper)["wire"], signal.SIGKILL)
        until(lambda: bool(log.host("safe", killed_ns)), "the root holds it, by the wire's own port")
        assert log.setpoints_after_safe(killed_ns) == 0


def test_a_gripper_at_another_baud_rate_is_named(twin: TwinProcess) -> None:
    gripper = Robot("robotiq_2f85", mode="real", port=twin.port)
    try:
        assert "does not answer" in (gripper.connect_eagerly() or "")
        assert "garbled" in [kind for kind, _ in twin.logged("host")]
    finally:
        gripper.cleanup()
