"""Test a twin's process: its port, its log, its control lines, and its end."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from strands_actors.drivers.common.twin import PtyLine
from strands_actors.drivers.feetech import protocol as p
from tests.answers import PATIENCE_S, until

from .twin_process import TwinProcess


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[TwinProcess]:
    with TwinProcess(tmp_path) as process:
        yield process


def answers(port: serial.Serial, request: bytes) -> bool:
    """Return True if one status arrives before another request would be sent."""
    port.write(request)
    return len(port.read(6)) == 6


def test_every_frame_is_in_the_log_with_its_kind_and_time(twin: TwinProcess) -> None:
    before_ns = time.monotonic_ns()
    with twin.connect() as port:
        for request in (p.ping(1), p.write(1, p.TORQUE_ENABLE, 1), p.write(1, p.GOAL_POSITION, 2048)):
            assert answers(port, request)
        port.write(p.LIMP)
        until(lambda: len(twin.logged("host")) == 4, "four requests logged")
    kinds = ["read", "enable", "setpoint", "safe"]
    assert [kind for kind, _ in twin.logged("host")] == kinds
    assert [kind for kind, _ in twin.logged("robot")] == kinds[:3]
    assert twin.logged("host")[3][1] == p.LIMP.hex()
    assert list(twin.log()[0]) == ["t_ns", "from", "kind", "hex"]
    times = [line["t_ns"] for line in twin.log()]
    assert times == sorted(times)
    assert before_ns < times[0] <= times[-1] < time.monotonic_ns()


def test_a_reply_takes_the_time_of_its_bytes(twin: TwinProcess) -> None:
    with twin.connect() as port:
        assert answers(port, p.ping(1))
    request, reply = (line["t_ns"] for line in twin.log())
    assert reply - request >= 500_000 + 12 * 10_000  # the factory's return delay and 12 bytes at 1 Mbit/s


def test_a_client_at_another_rate_gets_no_answer(twin: TwinProcess) -> None:
    with twin.connect(500_000) as port:
        port.write(p.ping(1))
        until(lambda: len(twin.logged("host")) == 1, "the ping is on the wire")
    with twin.connect() as port:
        assert answers(port, p.ping(2))
    assert [hexa for _, hexa in twin.logged("robot")] == [p.frame(2, 0).hex()]


def test_a_delayed_reply_comes_late_while_the_wire_goes_on(twin: TwinProcess) -> None:
    twin.command("fault delayed:3")
    with twin.connect() as port:
        while True:  # the control line may be read after the first pings
            port.write(p.ping(3) + p.ping(2))
            order = [packet.id for packet in p.Decoder().feed(port.read(12))]
            if order == [2, 3]:
                break
    lines = twin.log()[-4:]
    assert [line["from"] for line in lines] == ["host", "host", "robot", "robot"]
    requested, _, other, late = (line["t_ns"] for line in lines)
    assert late - requested >= 60_000_000
    assert other < late


def test_faults_from_the_start_and_out_of_order_control_lines(tmp_path: Path) -> None:
    with TwinProcess(tmp_path, fault="off:2") as twin, twin.connect() as port:
        twin.command("nonsense")
        twin.command("fault broken")
        port.write(p.ping(2))
        assert answers(port, p.ping(1))
        assert [hexa for _, hexa in twin.logged("robot")] == [p.frame(1, 0).hex()]
        twin.command("fault ok:2")
        port.timeout = 0.05
        until(lambda: answers(port, p.ping(2)), "servo 2 is back")
        twin.process.terminate()
        _, error = twin.process.communicate(timeout=PATIENCE_S)
    assert b"unknown control line 'nonsense'" in error
    assert b"intermittent" in error


def test_a_pulled_cable_hangs_up_and_comes_back_under_the_same_name(twin: TwinProcess) -> None:
    with twin.connect() as port:
        assert answers(port, p.write(1, p.ACCELERATION, 9))
        twin.command("unplug")
        with pytest.raises(OSError):  # from the read or from the write, depending on timing
            while True:
                port.timeout = 0.05
                port.write(p.ping(1))
                port.read(6)
        assert not os.path.lexists(twin.port)
    twin.command("plug")
    with twin.connect() as port:
        port.write(p.read(1, p.ACCELERATION.address, 1))
        (packet,) = p.Decoder().feed(port.read(7))
    assert packet.params == b"\x09"  # only the cable was unplugged; the servo had power


def test_usr1_and_the_control_line_take_the_power_away(twin: TwinProcess) -> None:
    with twin.connect() as port:
        for cut in (lambda: twin.process.send_signal(signal.SIGUSR1), lambda: twin.command("power-cycle")):
            assert answers(port, p.write(1, p.ACCELERATION, 9))
            cut()

            def is_new() -> bool:
                port.write(p.read(1, p.ACCELERATION.address, 1))
                (packet,) = p.Decoder().feed(port.read(7))
                return packet.params == b"\x00"

            until(is_new, "RAM is as at delivery")


def test_a_frozen_robot_answers_afterwards(twin: TwinProcess) -> None:
    with twin.connect() as port:
        twin.command("freeze 0.5")
        longest_ns = 0
        until = time.monotonic() + PATIENCE_S
        while longest_ns < 300_000_000 and time.monotonic() < until:
            start_ns = time.monotonic_ns()
            assert answers(port, p.ping(1))
            longest_ns = max(longest_ns, time.monotonic_ns() - start_ns)
    assert longest_ns >= 300_000_000


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_process_and_leaves_no_files(tmp_path: Path, number: signal.Signals) -> None:
    link = tmp_path / "ttyTWIN"
    with TwinProcess(tmp_path, options={"link": str(link)}) as twin:
        assert twin.port == str(link)
        assert link.is_symlink()
        twin.process.send_signal(number)
        _, error = twin.process.communicate(timeout=PATIENCE_S)
        assert (twin.process.returncode, error) == (0, b"")
    assert not link.is_symlink()
    assert not twin.port_file.exists()


def test_a_port_never_takes_the_place_of_a_file(tmp_path: Path) -> None:
    with pytest.raises(FileExistsError, match="choose another name"):
        PtyLine(str(tmp_path))


@pytest.mark.long
def test_it_outlives_its_parent_long_enough_to_log_the_end(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    try:
        with TwinProcess(tmp_path, parent_fd=reading) as twin, twin.connect() as port:
            assert answers(port, p.ping(1))
            os.close(writing)
            writing = -1
            died_ns = time.monotonic_ns()
            port.write(p.LIMP)
            twin.process.wait(timeout=PATIENCE_S)
            assert time.monotonic_ns() - died_ns >= 2_500_000_000
            assert twin.process.returncode == 0
            assert twin.logged("host")[-1] == ("safe", p.LIMP.hex())
    finally:
        os.close(reading)
        if writing >= 0:
            os.close(writing)
