"""Test the vendor's unmodified SDK against the twin on a real pseudo-terminal."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import scservo_sdk as sdk
from scservo_sdk import port_handler

from strands_actors.drivers.feetech import protocol as p
from tests.answers import until
from tests.drivers.common.twin_process import TwinProcess

IDS = [1, 2, 3, 4, 5, 6]


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[TwinProcess]:
    with TwinProcess(tmp_path) as process:
        yield process


@pytest.fixture
def port(twin: TwinProcess, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    # 34 ms of wall clock are too short on a busy machine. After one late reply this SDK never recovers.
    monkeypatch.setattr(port_handler, "LATENCY_TIMER", 2000)
    handler = sdk.PortHandler(twin.port)
    assert handler.openPort()
    yield handler
    handler.closePort()


@pytest.fixture
def packets() -> Any:
    return sdk.PacketHandler(0)  # 0: the byte order of STS and SMS servos


def read1(packets: Any, port: Any, servo_id: int, register: p.Register) -> int:
    value, result, error = packets.read1ByteTxRx(port, servo_id, register.address)
    assert (result, error) == (sdk.COMM_SUCCESS, 0)
    return int(value)


def write1(packets: Any, port: Any, servo_id: int, register: p.Register, value: int) -> None:
    assert packets.write1ByteTxRx(port, servo_id, register.address, value) == (sdk.COMM_SUCCESS, 0)


def test_ping(packets: Any, port: Any, twin: TwinProcess) -> None:
    for servo_id in IDS:
        assert packets.ping(port, servo_id) == (777, sdk.COMM_SUCCESS, 0)
    assert twin.logged("host")[0] == ("read", p.ping(1).hex())
    assert twin.logged("robot")[0] == ("read", p.frame(1, 0).hex())


def test_broadcast_ping(packets: Any, port: Any) -> None:
    assert packets.txPacket(port, [0, 0, sdk.BROADCAST_ID, 2, sdk.INST_PING, 0]) == sdk.COMM_SUCCESS
    received = []
    for _ in IDS:
        port.setPacketTimeout(6)
        status, result = packets.rxPacket(port)
        assert result == sdk.COMM_SUCCESS
        received.append(status[2])
    port.is_using = False
    assert received == IDS


def test_read_and_write_one_and_two_bytes(packets: Any, port: Any, twin: TwinProcess) -> None:
    assert read1(packets, port, 1, p.RETURN_DELAY) == 250
    write1(packets, port, 1, p.RETURN_DELAY, 0)
    assert read1(packets, port, 1, p.RETURN_DELAY) == 0
    assert packets.read2ByteTxRx(port, 4, p.POSITION.address)[1:] == (sdk.COMM_SUCCESS, 0)
    goal = p.GOAL_POSITION.address
    assert packets.write2ByteTxRx(port, 4, goal, 2100) == (sdk.COMM_SUCCESS, 0)
    assert packets.read2ByteTxRx(port, 4, goal) == (2100, sdk.COMM_SUCCESS, 0)
    assert ("setpoint", p.write(4, p.GOAL_POSITION, 2100).hex()) in twin.logged("host")
    assert ("config", p.write(1, p.RETURN_DELAY, 0).hex()) in twin.logged("host")


def test_sync_write_and_sync_read(packets: Any, port: Any, twin: TwinProcess) -> None:
    goals = {servo_id: 2048 + 10 * servo_id for servo_id in IDS}
    writer = sdk.GroupSyncWrite(port, packets, p.GOAL_POSITION.address, 2)
    for servo_id, goal in goals.items():
        assert writer.addParam(servo_id, list(p.GOAL_POSITION.encode(goal)))
    assert writer.txPacket() == sdk.COMM_SUCCESS
    reader = sdk.GroupSyncRead(port, packets, p.GOAL_POSITION.address, 2)
    for servo_id in reversed(IDS):
        assert reader.addParam(servo_id)
    assert reader.txRxPacket() == sdk.COMM_SUCCESS
    assert {i: reader.getData(i, p.GOAL_POSITION.address, 2) for i in IDS} == goals
    host = twin.logged("host")
    assert host[0] == ("setpoint", p.sync_write(p.GOAL_POSITION, goals).hex())
    assert host[1] == ("read", p.sync_read(IDS[::-1], p.GOAL_POSITION.address, 2).hex())
    assert [bytes.fromhex(line)[2] for _, line in twin.logged("robot")] == IDS[::-1]


def test_torque_moves_the_joint_to_its_goal(packets: Any, port: Any, twin: TwinProcess) -> None:
    assert packets.write2ByteTxRx(port, 1, p.GOAL_POSITION.address, 2400) == (sdk.COMM_SUCCESS, 0)
    write1(packets, port, 1, p.TORQUE_ENABLE, 1)

    def there() -> bool:
        position, result, error = packets.read2ByteTxRx(port, 1, p.POSITION.address)
        assert (result, error) == (sdk.COMM_SUCCESS, 0)
        return abs(position - 2400) < 10

    until(there, "the joint is at its goal")
    write1(packets, port, 1, p.TORQUE_ENABLE, 0)
    assert [kind for kind, _ in twin.logged("host") if kind != "read"] == ["setpoint", "enable", "safe"]


def test_the_eeprom_keeps_what_was_written_unlocked(packets: Any, port: Any, twin: TwinProcess) -> None:
    write1(packets, port, 2, p.P_GAIN, 16)
    write1(packets, port, 3, p.LOCK, 0)
    write1(packets, port, 3, p.P_GAIN, 16)
    write1(packets, port, 3, p.LOCK, 1)
    write1(packets, port, 3, p.ACCELERATION, 9)
    twin.command("power-cycle")
    until(lambda: read1(packets, port, 3, p.ACCELERATION) == 0, "the power was away")
    assert read1(packets, port, 2, p.P_GAIN) == 32
    assert read1(packets, port, 3, p.P_GAIN) == 16


def test_a_servo_that_is_not_there_is_a_timeout(packets: Any, port: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(port_handler, "LATENCY_TIMER", 16)
    assert packets.ping(port, 9)[1] == sdk.COMM_RX_TIMEOUT
