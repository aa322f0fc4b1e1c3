"""Test a serial line. Only one process may have the port open, so a process that is done with it closes it."""

from __future__ import annotations

import os
import pty
import signal
import tty
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import trio

from strands_actors.drivers.common.ports.serial_port import open_serial
from strands_actors.drivers.crazyflie import cpx
from strands_actors.drivers.crazyflie.driver import Crazyflie
from strands_actors.drivers.crazyflie.links import BAUD, READY_S, SerialLink, open_line
from strands_actors.drivers.crazyflie.stop_channel import CrazyflieStopChannel
from strands_actors.kernel.clock import MonotonicClock
from tests.answers import json_of, pids, state, until
from tests.drivers.common.memory_port import MemoryPort, virtual
from tests.drivers.common.twin_process import TwinProcess
from tests.trees import armed, robot_on

QUICK_S = 4.0
"""Much less than an attempt may take. An attempt on a dead descriptor ends at once."""


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[TwinProcess]:
    with TwinProcess(tmp_path, "crazyflie", "crazyflie", options={"link": "serial"}) as process:
        yield process


def path_of(twin: TwinProcess) -> str:
    return twin.port.removeprefix("serial://")


def pull(twin: TwinProcess) -> None:
    twin.command("unplug")
    until(lambda: not os.path.exists(path_of(twin)), "it is pulled")


def put_back(twin: TwinProcess) -> None:
    twin.command("plug")
    until(lambda: os.path.exists(path_of(twin)), "it is back")


@contextmanager
def own_ways(twin: TwinProcess, line: SerialLink) -> Iterator[list[CrazyflieStopChannel]]:
    """Yield the channels that root and standby make from the wire's descriptors."""
    driver = Crazyflie("crazyflie", twin.port, {})
    ways = [
        CrazyflieStopChannel(driver.config, [os.dup(fd) for fd in line.handover()], MonotonicClock())
        for _ in ("root", "standby")
    ]
    try:
        yield ways
    finally:
        for way in ways:
            way.close()


def test_saf_003_the_wire_comes_back_after_its_process_is_killed(twin: TwinProcess, run_dir: Path) -> None:
    with robot_on(twin.port, "crazyflie") as robot:
        armed(robot)
        first = pids(robot)["wire"]
        os.kill(first, signal.SIGKILL)
        until(
            lambda: pids(robot).get("wire", first) != first and state(robot) == "disarmed", "it is back, disarmed"
        )
        json_of(robot.resume())


def test_saf_020_an_adapter_that_is_pulled_is_let_go_of_and_the_wire_comes_back(
    twin: TwinProcess, run_dir: Path
) -> None:
    with robot_on(twin.port, "crazyflie") as robot:
        armed(robot)
        terminal = os.path.realpath(path_of(twin))

        def holders() -> list[str]:
            return [role for role, pid in pids(robot).items() if any(terminal in name for name in open_files(pid))]

        assert {"root", "standby", "wire"} <= set(holders())
        pull(twin)
        until(lambda: holders() == [], "nobody has it open")
        put_back(twin)
        until(lambda: state(robot) == "disarmed", "it is back, disarmed")
        json_of(robot.resume())


def open_files(pid: int) -> Iterator[str]:
    with suppress(FileNotFoundError):  # the process has ended
        for entry in os.listdir(f"/proc/{pid}/fd"):
            with suppress(FileNotFoundError):
                yield os.readlink(f"/proc/{pid}/fd/{entry}")


def test_saf_020_root_and_standby_let_go_of_an_adapter_that_was_pulled_and_reach_it_when_it_is_back(
    twin: TwinProcess,
) -> None:
    """A process that kept it open would give the adapter another name when it comes back."""

    async def main() -> None:
        line = await open_line(path_of(twin))
        with own_ways(twin, line) as ways:
            with trio.fail_after(10):
                async with trio.open_nursery() as nursery:
                    for way in ways:
                        await nursery.start(way.serve)
                    pull(twin)
                    line.close()
            for way in ways:
                assert not any(report.written or report.safe for report in await way.make_safe("land"))
            put_back(twin)
            for way in ways:
                assert all(report.safe for report in await way.make_safe("land"))
                way.close()

    trio.run(main)


def test_saf_005_a_dead_descriptor_is_given_up_at_once_and_the_port_reopened(twin: TwinProcess) -> None:
    async def main() -> None:
        line = await open_line(path_of(twin))
        with own_ways(twin, line) as (way, _):
            line.close()
            pull(twin)
            put_back(twin)
            began_s = trio.current_time()
            assert all(report.safe for report in await way.make_safe("land"))
            assert trio.current_time() - began_s < QUICK_S
            pull(twin)
            began_s = trio.current_time()
            assert not any(report.written for report in await way.make_safe("land"))
            assert trio.current_time() - began_s < QUICK_S, "the stop does not wait on a dead port"

    trio.run(main)


def test_a_stop_channel_closes_its_descriptor() -> None:
    """An open descriptor would keep the lock, and keep the next wire from the port."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    wire = open_serial(path, BAUD)
    config = Crazyflie("crazyflie", f"serial://{path}", {}).config
    way = CrazyflieStopChannel(config, [os.dup(wire.fileno())], MonotonicClock())
    os.close(wire.fileno())  # as the end of a killed process does
    way.close()
    open_serial(path, BAUD).close()
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize("speaks_first", [True, False])
def test_a_robot_that_reports_ready_only_after_a_frame_is_asked(speaks_first: bool) -> None:
    """A drone that has talked to another of our processes does so."""

    def robot(data: bytes) -> Iterable[tuple[float, bytes]]:
        yield from ((0.01, cpx.READY) for packet in cpx.UartDecoder().feed(data) if packet)

    async def main() -> None:
        port = MemoryPort(robot)
        if speaks_first:
            port.peer = lambda data: [(0.1, cpx.READY)]
            port.write(b"")
            port.peer = robot
        await SerialLink(port, "serial://memory").bridge()
        assert trio.current_time() < READY_S
        frames = [cpx.uart_frame(cpx.packet(cpx.Function.SYSTEM, data)) for data in (cpx.BRIDGE, cpx.CLIENT)]
        assert [data for _, data in port.written if data] == [cpx.READY, *frames]

    virtual(main)
