"""Test the Robotiq twin: its gripper in virtual time, then its process with an unmodified pymodbus client."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymodbus.client import ModbusTcpClient

from strands_actors.drivers.common.ports.modbus import Decoder
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.robotiq import protocol as p
from strands_actors.drivers.robotiq.mechanism import Gripper, Setup
from strands_actors.drivers.robotiq.robots import TABLES
from strands_actors.drivers.robotiq.sessions import TcpSession
from strands_actors.drivers.robotiq.twin import main, twin_of
from strands_actors.testing import Twin
from tests.answers import PATIENCE_S, until
from tests.drivers.common.twin_process import TwinProcess

# -- the gripper


class Bench:
    def __init__(self, **bench: object) -> None:
        self.now_s = 0.0
        self.gripper = Gripper(Setup.from_table(TABLES.table("robotiq_2f85"), **bench), lambda: self.now_s)

    def after(self, seconds: float) -> p.Status:
        """Let time pass, as with a client that reads the gripper at 50 Hz."""
        for _ in range(round(seconds * 50)):
            self.now_s += 0.02
            self.gripper.note_request()
        self.gripper.note_request()
        return self.gripper.status()

    def go(self, position: int, speed: int = 255, force: int = 255) -> None:
        self.gripper.write(p.Command(go_to=True, position=position, speed=speed, force=force))


def test_activation_takes_its_time_and_the_whole_stroke() -> None:
    bench = Bench()
    assert bench.after(0).activation == p.Activation.RESET
    bench.gripper.write(p.ACTIVATE)
    assert bench.after(0.5).activation == p.Activation.ACTIVATING
    assert max(bench.after(0.02).position for _ in range(20)) > 200
    status = bench.after(0.7)
    assert (status.activation, status.position, status.fault) == (p.Activation.ACTIVE, 3, 0)


def test_going_too_early_is_a_fault_that_passes() -> None:
    bench = Bench()
    bench.go(100)
    assert bench.after(0.1).fault == 5
    assert bench.after(2.0).fault == 0
    bench.gripper.write(p.Command(activate=False, go_to=True))
    assert bench.after(0.1).fault == 7


@pytest.mark.parametrize(("speed", "mm_s"), [(0, 20.0), (128, 85.0), (255, 150.0)])
def test_its_speed(speed: int, mm_s: float) -> None:
    bench = Bench(activated=True)
    bench.go(230, speed)
    moved_mm = (bench.after(0.4).position - 3) / 255 * 85
    assert moved_mm == pytest.approx(0.4 * mm_s, abs=0.4)


def test_the_echo_comes_at_once_and_the_first_reading_shows_motion() -> None:
    bench = Bench(activated=True)
    bench.go(3)
    status = bench.gripper.status()
    assert (status.request, status.contact, status.going) == (3, p.Contact.MOVING, True)
    assert bench.after(0.02).contact == p.Contact.ARRIVED


def test_a_command_can_take_a_while_to_count() -> None:
    bench = Bench(activated=True, echo_s=0.1)
    bench.go(200)
    assert bench.after(0.08).request == 3
    assert bench.after(0.04).request == 200


def test_the_ends_of_its_scale() -> None:
    bench = Bench(activated=True)
    bench.go(255)
    status = bench.after(2)
    assert (status.position, status.contact) == (230, p.Contact.ARRIVED)
    bench.go(0)
    assert bench.after(2).position == 3


def test_an_object_stops_it_while_closing_only() -> None:
    bench = Bench(activated=True, object_mm=42.5)
    bench.go(255, force=100)
    status = bench.after(1)
    assert (status.position, status.contact, status.current) == (128, p.Contact.CLOSING, 50)
    bench.go(0)
    status = bench.after(1)
    assert (status.position, status.contact, status.current) == (3, p.Contact.ARRIVED, 0)
    bench.go(60)
    assert bench.after(1).contact == p.Contact.ARRIVED


def test_a_hold_stops_it_where_it_is() -> None:
    bench = Bench(activated=True)
    bench.go(230, 0)
    held = bench.after(1)
    bench.gripper.write(p.safe_command(held))
    status = bench.after(1)
    assert (status.position, status.going, status.activation) == (held.position, False, p.Activation.ACTIVE)


def test_a_silence_is_reported_once() -> None:
    bench = Bench(activated=True)
    bench.after(0.1)
    bench.now_s += 1.5
    assert bench.after(0).fault == p.SILENCE
    assert bench.after(0.02).fault == 0


def test_the_automatic_release_opens_slowly_and_needs_a_new_activation() -> None:
    bench = Bench(activated=True)
    bench.go(100)
    bench.after(1)
    bench.gripper.write(p.Command(release=True))
    first = bench.after(0.5)
    assert first.fault == p.RELEASING
    assert 60 < first.position < 100
    status = bench.after(5)
    assert (status.fault, status.position) == (p.RELEASED, 3)
    bench.go(100)
    assert bench.after(1).position == 3
    bench.gripper.write(p.RESET)
    bench.gripper.write(p.ACTIVATE)
    assert bench.after(2).fault == 0


def test_a_pause_of_the_process_is_not_caught_up() -> None:
    bench = Bench(activated=True)
    bench.go(230, 0)
    bench.after(0.1)
    bench.now_s += 60
    bench.gripper.note_request()
    assert bench.gripper.status().position < 100


# -- its reports


def test_off_resets_the_gripper_and_stuck_detects_nothing() -> None:
    now_s = [0.0]
    twin = twin_of("robotiq_2f85", lambda: now_s[0], activated=True)
    twin.set_fault(Fault.STUCK)
    felt = twin.status()
    twin.write(0, p.Command(go_to=True, position=200).registers())
    now_s[0] += 0.4
    twin.gripper.note_request()
    assert twin.status() == felt
    twin.set_fault(Fault.WRONG)
    assert twin.status().position == 255 - twin.gripper.status().position
    twin.set_fault(Fault.OFF)
    twin.set_fault(Fault.OK)
    assert twin.status().activation == p.Activation.RESET


def test_an_unknown_option_or_robot_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="object_mm"):
        main("robotiq_2f85", options={"speed": 2})
    with pytest.raises(ValueError, match="robotiq_2f85"):
        main("robotiq_3f")


@settings(max_examples=150, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([9, 0]),
            st.sampled_from([1, 3, 4, 6, 16, 22, 0x2B]),
            st.sampled_from([999, 1000, 1002, 2000, 2001, 2003]),
            st.integers(0, 4),
            st.binary(max_size=10),
        ),
        max_size=8,
    )
)
def test_no_request_breaks_the_twin(sent: list[tuple[int, int, int, int, bytes]]) -> None:
    twin = twin_of("robotiq_2f85", lambda: 0.0, activated=True)
    session = TcpSession(twin)
    for unit, function, address, count, rest in sent:
        body = bytes((unit, function)) + address.to_bytes(2, "big") + count.to_bytes(2, "big") + rest
        frame = b"\0\1\0\0" + len(body).to_bytes(2, "big") + body
        try:
            exchanges = list(session.receive(frame, None))
        except Exception as ended:
            assert type(ended).__name__ == "ClientGone"
            session = TcpSession(twin)
            continue
        for exchange in exchanges:
            assert [len(list(Decoder(requests=False).feed(reply.data))) for reply in exchange.replies] == [1]


# -- its process


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[TwinProcess]:
    with TwinProcess(
        tmp_path, "robotiq_2f85", "robotiq", options={"activation_s": 0.2, "object_mm": 30}
    ) as process:
        yield process


@pytest.fixture
def client(twin: TwinProcess) -> Iterator[ModbusTcpClient]:
    with connect(twin) as one:
        yield one


def connect(twin: TwinProcess, timeout: float = PATIENCE_S) -> ModbusTcpClient:
    host, port = address(twin)
    client = ModbusTcpClient(host, port=port, timeout=timeout, retries=0)
    assert client.connect()
    return client


def address(twin: TwinProcess) -> tuple[str, int]:
    host, _, port = twin.port.partition(":")
    return host, int(port)


def status_of(client: ModbusTcpClient) -> p.Status:
    return p.Status.from_registers(client.read_input_registers(2000, count=3, device_id=9).registers)


def tell(client: ModbusTcpClient, command: p.Command) -> None:
    assert not client.write_registers(1000, command.registers(), device_id=9).isError()


def test_an_unmodified_client_activates_and_grips(twin: TwinProcess, client: ModbusTcpClient) -> None:
    assert twin.port.startswith("127.") and not twin.port.startswith("127.0.0.1:")
    tell(client, p.RESET)
    tell(client, p.ACTIVATE)
    until(lambda: status_of(client).active, "it is activated")
    tell(client, p.Command(go_to=True, position=255, speed=255, force=0))
    until(lambda: status_of(client).contact == p.Contact.CLOSING, "it grips")
    assert client.read_holding_registers(1000, count=3, device_id=9).registers == [0x0900, 255, 0xFF00]
    tell(client, p.Command(position=165))
    kinds = [kind for kind, _ in twin.logged("host") if kind != "read"]
    assert kinds == ["safe", "enable", "setpoint", "safe"]
    assert twin.log()[-1]["hex"] == twin.logged("robot")[-1][1]
    assert [line.get("safe_state") for line in twin.log() if line["kind"] == "safe" and line["from"] == "host"] == [
        "hold",
        "hold",
    ]


def test_wrong_units_addresses_and_functions_are_answered_with_exceptions(client: ModbusTcpClient) -> None:
    assert client.read_input_registers(2000, count=3, device_id=1).exception_code == 11
    assert client.read_input_registers(1990, count=3, device_id=9).exception_code == 2
    assert client.write_registers(2000, [0], device_id=9).exception_code == 2
    assert client.read_coils(0, count=1, device_id=9).exception_code == 1
    assert status_of(client).activation == p.Activation.RESET


def test_some_of_the_registers_can_be_written(client: ModbusTcpClient) -> None:
    assert not client.write_registers(1001, [0x0040], device_id=9).isError()
    assert client.read_holding_registers(1000, count=3, device_id=9).registers == [0, 0x40, 0]
    assert client.read_input_registers(2001, count=1, device_id=9).registers == [0x40]


def test_several_clients_are_served(twin: TwinProcess, client: ModbusTcpClient) -> None:
    with connect(twin) as other:
        tell(other, p.ACTIVATE)
        until(lambda: status_of(client).active, "one sees what the other did")
    assert status_of(client).active


def test_noise_ends_the_connection_and_no_others(twin: TwinProcess, client: ModbusTcpClient) -> None:
    with socket.create_connection(address(twin), PATIENCE_S) as noise:
        noise.sendall(b"GET / HTTP/1.1\r\n\r\n")
        with pytest.raises(ConnectionResetError):
            noise.recv(1)
    assert status_of(client).activation == p.Activation.RESET


def test_a_pulled_cable_ends_connections_and_refuses_new_ones(twin: TwinProcess, client: ModbusTcpClient) -> None:
    tell(client, p.ACTIVATE)
    until(lambda: status_of(client).active, "it is activated")

    def pulled() -> bool:
        try:
            socket.create_connection(address(twin), PATIENCE_S).close()
        except ConnectionRefusedError:
            return True
        except ConnectionResetError:
            pass  # it was accepted just before
        return False

    twin.command("unplug")
    until(pulled, "the cable is out")
    twin.command("plug")
    until(lambda: not pulled(), "the cable is in")
    with connect(twin) as again:
        assert status_of(again).active, "the gripper itself stays active"


def test_a_test_can_pull_the_cable_by_its_name(tmp_path: Path) -> None:
    with Twin("robotiq_2f85", tmp_path) as twin:
        host, _, port = twin.port.partition(":")
        twin.unplug()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((host, int(port)), PATIENCE_S)
        twin.plug()
        socket.create_connection((host, int(port)), PATIENCE_S).close()


def test_faults_take_effect(twin: TwinProcess, client: ModbusTcpClient) -> None:
    tell(client, p.ACTIVATE)
    until(lambda: status_of(client).active, "it is activated")
    position = status_of(client).position
    twin.command("fault wrong")
    until(lambda: status_of(client).position == 255 - position, "wrong values")
    twin.command("fault ok")
    until(lambda: status_of(client).position == position, "right values")
    twin.command("freeze 0.5")
    longest_s, deadline_s = 0.0, time.monotonic() + PATIENCE_S
    while longest_s < 0.3 and time.monotonic() < deadline_s:
        began_s = time.monotonic()
        status_of(client)
        longest_s = max(longest_s, time.monotonic() - began_s)
    assert longest_s >= 0.3


def test_a_delayed_answer_keeps_its_number(twin: TwinProcess) -> None:
    twin.command("fault delayed")
    with socket.create_connection(address(twin), PATIENCE_S) as one:
        question = bytes.fromhex("0001 0000 0006 09 04 07d0 0003")
        late_s = 0.0
        while late_s < 0.06:  # the control line may be read after the first request
            began_s = time.monotonic()
            one.sendall(question)
            assert one.recv(64)[:2] == b"\0\1"
            late_s = time.monotonic() - began_s


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_process_and_leaves_no_files(
    twin: TwinProcess, client: ModbusTcpClient, number: signal.Signals
) -> None:
    assert status_of(client) == p.Status(position=3)
    twin.process.send_signal(number)
    _, error = twin.process.communicate(timeout=PATIENCE_S)
    assert (twin.process.returncode, error) == (0, b"")
    assert not os.path.exists(twin.port_file)
