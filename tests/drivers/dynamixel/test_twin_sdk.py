"""Test the vendor's unmodified SDK against the twin on a real pseudo-terminal."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dynamixel_sdk as sdk
import pytest
from dynamixel_sdk import port_handler

from strands_actors.drivers.common.dynamixel import protocol as p
from strands_actors.drivers.common.dynamixel import table as t
from strands_actors.testing.twin import PATIENCE_S, Twin

IDS = [1, 2, 3, 4, 5, 6]
FINE = (sdk.COMM_SUCCESS, 0)


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("koch", tmp_path) as process:
        yield process


@pytest.fixture
def port(twin: Twin, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    # 16 ms of wall clock are too short on a busy machine.
    monkeypatch.setattr(port_handler, "LATENCY_TIMER", 2000)
    handler = sdk.PortHandler(twin.port)
    assert handler.openPort()
    assert handler.setBaudRate(1_000_000)
    yield handler
    handler.closePort()


@pytest.fixture
def packets() -> Any:
    return sdk.PacketHandler(2.0)


def test_ping(packets: Any, port: Any, twin: Twin) -> None:
    assert [packets.ping(port, servo_id) for servo_id in IDS] == [(1060, *FINE)] * 2 + [(1200, *FINE)] * 4
    assert [entry.data for entry in twin.log.host("read")] == [p.ping(servo_id) for servo_id in IDS]


def test_broadcast_ping(packets: Any, port: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(port_handler, "LATENCY_TIMER", 16)  # it always waits for the whole latency
    found, result = packets.broadcastPing(port)
    assert result == sdk.COMM_SUCCESS
    assert {servo_id: model for servo_id, (model, _) in found.items()} == {i: 1060 if i < 3 else 1200 for i in IDS}


def test_read_and_write_one_two_and_four_bytes(packets: Any, port: Any) -> None:
    assert packets.read1ByteTxRx(port, 1, t.RETURN_DELAY.address) == (250, *FINE)
    assert packets.write1ByteTxRx(port, 1, t.RETURN_DELAY.address, 0) == FINE
    assert packets.read1ByteTxRx(port, 1, t.RETURN_DELAY.address) == (0, *FINE)
    assert packets.write2ByteTxRx(port, 4, t.GOAL_CURRENT.address, 300) == FINE
    assert packets.read2ByteTxRx(port, 4, t.GOAL_CURRENT.address) == (300, *FINE)
    assert packets.write4ByteTxRx(port, 4, t.GOAL_POSITION.address, 2100) == FINE
    assert packets.read4ByteTxRx(port, 4, t.GOAL_POSITION.address) == (2100, *FINE)


@pytest.mark.parametrize("how", ["txRxPacket", "fastSyncRead"])
def test_sync_write_and_sync_read(packets: Any, port: Any, twin: Twin, how: str) -> None:
    goals = {servo_id: 2048 + 10 * servo_id for servo_id in IDS}
    writer = sdk.GroupSyncWrite(port, packets, t.GOAL_POSITION.address, 4)
    for servo_id, goal in goals.items():
        assert writer.addParam(servo_id, list(t.GOAL_POSITION.encode(goal)))
    assert writer.txPacket() == sdk.COMM_SUCCESS
    reader = sdk.GroupSyncRead(port, packets, t.GOAL_POSITION.address, 4)
    for servo_id in IDS:
        assert reader.addParam(servo_id)
    assert getattr(reader, how)() == sdk.COMM_SUCCESS
    assert {i: reader.getData(i, t.GOAL_POSITION.address, 4) for i in IDS} == goals
    assert [entry.data for entry in twin.log.host("setpoint")] == [p.goals(goals)]


def test_torque_moves_the_joint_to_its_goal(packets: Any, port: Any, twin: Twin) -> None:
    assert packets.write4ByteTxRx(port, 1, t.GOAL_POSITION.address, 2400) == FINE
    assert packets.write1ByteTxRx(port, 1, t.TORQUE_ENABLE.address, 1) == FINE
    deadline_s = time.monotonic() + PATIENCE_S
    while abs(packets.read4ByteTxRx(port, 1, t.POSITION.address)[0] - 2400) > 10:
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
    assert packets.write1ByteTxRx(port, 1, t.RETURN_DELAY.address, 0) == (sdk.COMM_SUCCESS, p.ACCESS_ERROR)
    assert packets.write1ByteTxRx(port, 1, t.TORQUE_ENABLE.address, 0) == FINE
    kinds = [entry.kind for entry in twin.log.entries() if entry.sender == "host" and entry.kind != "read"]
    assert kinds == ["setpoint", "enable", "config", "safe"]


def test_reboot_takes_torque_and_ram(packets: Any, port: Any) -> None:
    assert packets.write1ByteTxRx(port, 2, t.TORQUE_ENABLE.address, 1) == FINE
    assert packets.reboot(port, 2) == FINE
    assert packets.read1ByteTxRx(port, 2, t.TORQUE_ENABLE.address) == (0, *FINE)


def test_the_bus_watchdog_trips_and_is_cleared(packets: Any, port: Any) -> None:
    register = t.BUS_WATCHDOG.address
    assert packets.write1ByteTxRx(port, 1, t.TORQUE_ENABLE.address, 1) == FINE
    assert packets.write1ByteTxRx(port, 1, register, 5) == FINE
    time.sleep(0.3)
    assert packets.read1ByteTxRx(port, 1, register) == (0xFF, *FINE)
    assert packets.write4ByteTxRx(port, 1, t.GOAL_POSITION.address, 2100) == (sdk.COMM_SUCCESS, p.RANGE_ERROR)
    assert packets.write1ByteTxRx(port, 1, register, 0) == FINE
    assert packets.write4ByteTxRx(port, 1, t.GOAL_POSITION.address, 2100) == FINE


def test_a_servo_that_is_not_there_is_a_timeout(packets: Any, port: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(port_handler, "LATENCY_TIMER", 16)
    assert packets.ping(port, 9)[1] == sdk.COMM_RX_TIMEOUT


def test_requests_that_older_twins_did_not_have(packets: Any, port: Any) -> None:
    reader = sdk.GroupBulkRead(port, packets)
    rows = {1: (t.POSITION.address, 4), 3: (t.VOLTAGE.address, 2), 6: (t.TEMPERATURE.address, 1)}
    for servo_id, (address, size) in rows.items():
        assert reader.addParam(servo_id, address, size)
    assert reader.fastBulkRead() == sdk.COMM_SUCCESS
    assert {servo_id: reader.getData(servo_id, *row) for servo_id, row in rows.items()} == {
        1: packets.read4ByteTxRx(port, 1, t.POSITION.address)[0],
        3: 50,
        6: 30,
    }
    for at in range(4):  # the goal, through indirect addresses of the host's choice
        assert packets.write2ByteTxRx(port, 1, 168 + 2 * at, t.GOAL_POSITION.address + at) == FINE
    assert packets.write4ByteTxRx(port, 1, 224, 2222) == FINE
    assert packets.read4ByteTxRx(port, 1, t.GOAL_POSITION.address) == (2222, *FINE)
    assert packets.clearMultiTurn(port, 1) == FINE
    assert packets.write1ByteTxRx(port, 1, t.MODE.address, 5) == (sdk.COMM_SUCCESS, p.RANGE_ERROR)
    assert packets.write2ByteTxRx(port, 4, t.GOAL_CURRENT.address, 3000) == (sdk.COMM_SUCCESS, p.LIMIT_ERROR)
    assert packets.write1ByteTxRx(port, 2, t.RETURN_DELAY.address, 0) == FINE
    assert packets.factoryReset(port, 2, 0x02) == FINE
    assert packets.read1ByteTxRx(port, 2, t.RETURN_DELAY.address) == (250, *FINE)
