"""Test the twin as a process, with a client that shares no code with it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.answers import until
from tests.drivers.common.twin_process import TwinProcess

from .kortex_client import Client, KortexError, joint_speeds, number

STOP, SPEEDS, EMERGENCY_STOP, CLEAR_FAULTS = 0x20070, 0x20084, 0x20091, 0x20092
SET_MODE, GET_MODE, ACTUATORS, ARM_STATE = 0x20098, 0x20099, 0x200AB, 0x200AF
KEEP_ALIVE, CLOSE_SESSION, REFRESH_FEEDBACK = 0x10003, 0x10002, 0x30003


def twin_of(directory: Path, **options: object) -> TwinProcess:
    return TwinProcess(directory, "kinova_gen3", "kinova", options=options)


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[TwinProcess]:
    with twin_of(tmp_path) as process:
        yield process


@pytest.fixture
def client(twin: TwinProcess) -> Iterator[Client]:
    with Client(twin.port) as connected:
        yield connected.log_in()


def sub_error(client: Client, function: int, payload: bytes = b"") -> int:
    with pytest.raises(KortexError) as failed:
        client.call(function, payload)
    return failed.value.sub


def is_there(address: str) -> bool:
    try:
        Client(address).socket.close()
    except ConnectionError:
        return False
    return True


def velocity(client: Client, joint: int = 0) -> float:
    return client.refresh_feedback()[1][joint][1]


def test_a_clients_day(client: Client, twin: TwinProcess) -> None:
    assert twin.port.endswith(":10000")
    assert client.session > 0
    assert client.call(ACTUATORS)[1] == [7]
    assert client.call(ARM_STATE)[1] == [7]
    assert client.call(GET_MODE)[1] == [2]
    state, joints = client.refresh_feedback()
    assert state == 7
    assert [round(position, 1) for position, _ in joints] == [0.0, 15.0, 180.0, 230.0, 0.0, 55.0, 90.0]
    client.send_joint_speeds(20.0, 0, 0, 0, 0, 0, -10.0)
    until(lambda: velocity(client) > 19.0, "it turns")
    assert velocity(client, 6) == pytest.approx(-10.0, abs=1.0)
    client.call(STOP)
    until(lambda: abs(velocity(client)) < 0.1, "it stands")
    client.call(CLOSE_SESSION)
    assert sub_error(client, ARM_STATE) == 12
    kinds = [kind for kind, _ in twin.logged("host") if kind != "read"]
    assert kinds == ["config", "setpoint", "safe", "config"]


@pytest.mark.long
def test_joint_speeds_never_expire(client: Client, twin: TwinProcess) -> None:
    """Neither silence nor the end of the session or of the connection ends them."""
    client.send_joint_speeds(5.0)
    time.sleep(1.0)
    assert velocity(client) == pytest.approx(5.0, abs=0.5)
    client.socket.close()
    time.sleep(2.5)
    with Client(twin.port) as other:
        other.log_in()
        assert velocity(other) == pytest.approx(5.0, abs=0.5)
        other.call(STOP)


def test_feedback_that_is_stuck_stands_still_and_the_arm_goes_on(client: Client, twin: TwinProcess) -> None:
    def frame() -> object:
        return client.call(REFRESH_FEEDBACK)[1]

    frames = set()
    until(lambda: frames.add(str(frame())) or len(frames) > 2, "its frames are counted")
    client.send_joint_speeds(20.0)
    until(lambda: velocity(client) > 19.0, "it turns")
    twin.command("fault stuck")
    until(lambda: frame() == frame(), "it is stuck")
    stuck, before = frame(), client.refresh_feedback()
    time.sleep(0.5)
    assert (frame(), client.refresh_feedback()) == (stuck, before)
    twin.command("fault ok")
    until(lambda: frame() != stuck, "it measures again")
    _, joints = client.refresh_feedback()
    assert joints[0][0] - before[1][0][0] > 5.0 and joints[0][1] > 19.0, "the joint has turned in the meantime"


def test_no_speed_is_the_enabling_of_an_arm_that_stands(client: Client, twin: TwinProcess) -> None:
    client.send_joint_speeds(*[0.0] * 7)
    client.send_joint_speeds(*[0.0] * 7)
    client.call(STOP)
    assert [kind for kind, _ in twin.logged("host")][1:] == ["enable", "setpoint", "safe"]


@pytest.mark.parametrize(("user", "sub"), [("admin", 15), ("eve", 16)])
def test_a_stranger_is_turned_away_and_no_password_is_logged(twin: TwinProcess, user: str, sub: int) -> None:
    with Client(twin.port) as client, pytest.raises(KortexError) as failed:
        client.log_in(user, "hunter2")
    assert (failed.value.code, failed.value.sub) == (1, sub)
    ((_, text),) = twin.logged("host")
    assert user.encode() in bytes.fromhex(text) and b"hunter2" not in bytes.fromhex(text)


def test_a_twin_has_the_login_it_was_given(tmp_path: Path) -> None:
    with twin_of(tmp_path, username="me", password="mine") as twin, Client(twin.port) as client:
        client.log_in("me", "mine")


def test_calls_without_a_session_or_with_anothers_are_refused(client: Client, twin: TwinProcess) -> None:
    with Client(twin.port) as other:
        assert sub_error(other, STOP) == 12
        other.session = client.session
        assert sub_error(other, STOP) == 12


def test_a_silent_session_is_forgotten(twin: TwinProcess) -> None:
    with Client(twin.port) as client:
        client.log_in(session_ms=300)
        client.call(KEEP_ALIVE)
        time.sleep(0.5)
        assert sub_error(client, KEEP_ALIVE) == 12


@pytest.mark.parametrize(
    ("line", "sub"),
    [
        ("state IN_FAULT", 22),
        ("state IDLE", 21),
        ("state MAINTENANCE", 23),
        ("state PLAYING_SEQUENCE", 18),
        ("mode LOW_LEVEL", 75),
    ],
)
def test_a_base_that_is_not_ready_refuses_speeds(client: Client, twin: TwinProcess, line: str, sub: int) -> None:
    twin.command(line)
    until(lambda: client.call(ARM_STATE)[1] != [7] or client.call(GET_MODE)[1] != [2], line)
    with pytest.raises(KortexError) as failed:
        client.send_joint_speeds(1.0)
    assert failed.value.sub == sub


def test_a_fault_stops_the_arm_until_it_is_cleared(client: Client, twin: TwinProcess) -> None:
    client.send_joint_speeds(20.0)
    client.call(EMERGENCY_STOP)
    assert client.refresh_feedback()[0] == 4
    until(lambda: abs(velocity(client)) < 0.1, "it stands")
    client.call(CLEAR_FAULTS)
    client.send_joint_speeds(1.0)


@pytest.mark.parametrize(
    ("deg_s", "sub"), [((81.0,), 60), ((0, 0, 0, 0, 71.0), 60), ((float("nan"),), 59), ((0,) * 8, 57)]
)
def test_speeds_that_no_joint_has_are_refused(client: Client, deg_s: tuple[float, ...], sub: int) -> None:
    with pytest.raises(KortexError) as failed:
        client.send_joint_speeds(*deg_s)
    assert failed.value.sub == sub
    assert abs(velocity(client)) < 0.1


def test_unknown_requests_are_refused(client: Client) -> None:
    assert sub_error(client, SPEEDS, joint_speeds([0.0] * 6)) == 57
    assert sub_error(client, 0x200FF) == 5
    assert sub_error(client, 0x6F0001) == 4
    assert sub_error(client, SET_MODE, number(1, 9)) == 3
    assert sub_error(client, SET_MODE, b"\xff") == 13


def test_a_client_that_sends_garbage_is_disconnected(client: Client) -> None:
    client.socket.sendall(b"GET / HTTP/1.1\r\n\r\n")
    with pytest.raises(ConnectionError):
        client.call(KEEP_ALIVE)


@pytest.mark.parametrize(("second", "sub"), [("accepted", 0), ("refused", 1), ("powerless", 0)])
def test_each_kind_of_base_has_its_own_second_session(tmp_path: Path, second: str, sub: int) -> None:
    with twin_of(tmp_path, second=second) as twin, Client(twin.port) as first, Client(twin.port) as other:
        first.log_in()
        if sub:
            with pytest.raises(KortexError) as failed:
                other.log_in()
            assert failed.value.sub == sub
            first.call(CLOSE_SESSION)
            first.session = 0
        other.log_in()
        if second == "powerless":
            other.refresh_feedback()
            assert sub_error(other, STOP) == 130
        else:
            other.call(STOP)


def test_without_power_the_base_is_silent_and_restarts_as_new(client: Client, twin: TwinProcess) -> None:
    client.send_joint_speeds(20.0)
    twin.command("power-cycle")
    with pytest.raises(ConnectionError):
        while True:
            client.call(KEEP_ALIVE)
    until(lambda: is_there(twin.port), "it is back")
    with Client(twin.port) as other:
        other.log_in()
        until(lambda: abs(velocity(other)) < 0.1, "it stands: nobody remembers its speed")


def test_the_cable_may_be_pulled_twice_and_is_put_back_once(client: Client, twin: TwinProcess) -> None:
    for line in ("unplug", "unplug", "plug"):
        twin.command(line)
    with pytest.raises(ConnectionError):
        while True:
            client.call(KEEP_ALIVE)
    until(lambda: is_there(twin.port), "it is back")
    with Client(twin.port) as other:
        other.log_in()


def test_an_unknown_control_line_is_answered_with_the_known_ones(twin: TwinProcess) -> None:
    twin.command("state NOWHERE")
    twin.process.terminate()
    _, error = twin.process.communicate(timeout=20.0)
    assert b"unknown control line 'state NOWHERE'" in error
