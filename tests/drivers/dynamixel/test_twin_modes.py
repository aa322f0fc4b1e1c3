"""Test the servo modes of the twin other than positions, in virtual time."""

from __future__ import annotations

import struct

import pytest

from strands_actors.drivers.common.dynamixel import protocol as p
from strands_actors.drivers.common.dynamixel import table as t
from strands_actors.drivers.common.twin import Fault
from tests.drivers.dynamixel.test_twin import Bench

XL430, XL330 = 1, 5
"""Ids of a koch. The first has no current sensor."""


@pytest.fixture
def bench() -> Bench:
    return Bench()


def raw(bench: Bench, servo_id: int, code: int, params: bytes) -> p.Packet:
    return bench.status(p.frame(servo_id, code, params))


def read(bench: Bench, servo_id: int, address: int, size: int) -> p.Packet:
    return raw(bench, servo_id, p.READ, struct.pack("<HH", address, size))


def write(bench: Bench, servo_id: int, address: int, data: bytes) -> str:
    return raw(bench, servo_id, p.WRITE, struct.pack("<H", address) + data).failure


def test_a_model_takes_the_modes_that_it_has(bench: Bench) -> None:
    taken = {
        servo_id: [mode for mode in range(256) if not bench.put(servo_id, t.MODE, mode)]
        for servo_id in (XL430, XL330)
    }
    assert taken == {XL430: [1, 3, 4, 16], XL330: [0, 1, 3, 4, 5, 16]}
    assert bench.put(XL330, t.MODE, 2) == "data range error"


def test_goals_stay_within_their_limits(bench: Bench) -> None:
    for goal, limit in ((t.GOAL_CURRENT, 1750), (t.GOAL_VELOCITY, 445), (t.GOAL_PWM, 885)):
        for value in (limit, -limit, 0):
            assert bench.put(XL330, goal, value) == ""
        assert bench.put(XL330, goal, limit + 1) == bench.put(XL330, goal, -limit - 1) == "data limit error"
        assert bench.get(XL330, goal) == 0
    assert bench.put(XL330, t.VELOCITY_LIMIT, 100) == ""
    assert bench.put(XL330, t.GOAL_VELOCITY, 101) == "data limit error"
    assert bench.put(XL330, t.VELOCITY_LIMIT, 2048) == bench.put(XL330, t.CURRENT_LIMIT, 1751) == "data range error"


def test_the_table_is_as_delivered(bench: Bench) -> None:
    common = {t.SECONDARY_ID: 255, t.PROTOCOL_TYPE: 2, t.MOVING_THRESHOLD: 10, t.PWM_LIMIT: 885}
    for servo_id, own in (
        (
            XL430,
            {t.VELOCITY_I: 1000, t.VELOCITY_P: 100, t.POSITION_D: 4000, t.POSITION_P: 640, t.VELOCITY_LIMIT: 265},
        ),
        (XL330, {t.VELOCITY_I: 1600, t.VELOCITY_P: 180, t.POSITION_D: 0, t.POSITION_P: 400, t.VELOCITY_LIMIT: 445}),
    ):
        delivered = {**common, **own}
        assert {register: bench.get(servo_id, register) for register in delivered} == delivered


def test_velocity_pwm_and_current_turn_the_joint(bench: Bench) -> None:
    assert bench.put(XL330, t.MODE, t.VELOCITY_MODE) == ""
    bench.put(XL330, t.TORQUE_ENABLE, 1)
    bench.wait(0.3)
    start = bench.get(XL330, t.POSITION)
    assert abs(bench.get(XL330, t.VELOCITY)) <= 1, "the joint does not turn without a command"
    bench.put(XL330, t.GOAL_VELOCITY, 40)  # 9.2 rpm: 625 counts a second
    bench.wait(1.0)
    assert 450 < bench.get(XL330, t.POSITION) - start < 700
    assert 30 < bench.get(XL330, t.VELOCITY) < 50
    bench.put(XL330, t.GOAL_VELOCITY, 0)
    bench.wait(0.5)
    assert abs(bench.get(XL330, t.VELOCITY)) <= 1
    for mode, goal, value in ((t.PWM_MODE, t.GOAL_PWM, -400), (t.CURRENT_MODE, t.GOAL_CURRENT, 700)):
        bench.put(XL330, t.TORQUE_ENABLE, 0)
        assert bench.put(XL330, t.MODE, mode) == ""
        assert bench.get(XL330, goal) == 0
        bench.put(XL330, t.TORQUE_ENABLE, 1)
        before = bench.get(XL330, t.POSITION)
        bench.put(XL330, goal, value)
        bench.wait(0.3)
        assert (bench.get(XL330, t.POSITION) - before) * value > 0


def test_the_profile_velocity_limits_the_way_to_a_goal(bench: Bench) -> None:
    bench.put(XL430, t.TORQUE_ENABLE, 1)
    start = bench.get(XL430, t.POSITION)
    bench.put(XL430, t.PROFILE_VELOCITY, 20)  # 4.58 rpm: 313 counts a second
    bench.put(XL430, t.GOAL_POSITION, start + 800)
    bench.wait(1.0)
    assert 250 < bench.get(XL430, t.POSITION) - start < 340
    assert bench.get(XL430, t.MOVING_STATUS) & 0x02
    assert 250 < bench.get(XL430, t.POSITION_TRAJECTORY) - start < 340
    assert bench.get(XL430, t.VELOCITY_TRAJECTORY) == 20
    bench.wait(2.0)
    assert abs(bench.get(XL430, t.POSITION) - start - 800) < 20
    assert bench.get(XL430, t.MOVING_STATUS) & 0x03 == 0x01
    bench.put(XL430, t.TORQUE_ENABLE, 0)
    bench.put(XL430, t.DRIVE_MODE, 4)
    bench.put(XL430, t.TORQUE_ENABLE, 1)
    bench.put(XL430, t.PROFILE_VELOCITY, 2000)
    bench.put(XL430, t.GOAL_POSITION, start)
    bench.wait(1.0)
    assert 300 < bench.get(XL430, t.POSITION) - start < 500, "after half of the time the joint is half of the way"


def test_saf_013_a_bus_watchdog_ends_a_turn_and_a_profile(bench: Bench) -> None:
    bench.put(XL330, t.MODE, t.VELOCITY_MODE)
    bench.put(XL330, t.TORQUE_ENABLE, 1)
    bench.put(XL330, t.BUS_WATCHDOG, 5)
    bench.put(XL330, t.GOAL_VELOCITY, 40)
    bench.wait(0.5)  # other servos are read
    assert bench.get(XL330, t.BUS_WATCHDOG) == t.WATCHDOG_TRIPPED
    stood = bench.get(XL330, t.POSITION)
    bench.wait(0.5)
    assert abs(bench.get(XL330, t.POSITION) - stood) < 5


@pytest.mark.parametrize(("servo_id", "data"), [(XL430, 224), (XL430, 634), (XL330, 208)])
def test_indirect_addresses_show_registers_side_by_side(bench: Bench, servo_id: int, data: int) -> None:
    addresses = 578 if data == 634 else 168
    assert read(bench, servo_id, addresses, 2).params == struct.pack("<H", data), (
        "at first an indirect address shows its own default"
    )
    assert write(bench, servo_id, data, b"\x2a") == ""
    assert read(bench, servo_id, data, 1).params == b"\x2a"
    shown = [*range(t.POSITION.address, t.POSITION.address + 4), t.TEMPERATURE.address, t.LED.address]
    assert write(bench, servo_id, addresses, struct.pack("<6H", *shown)) == ""
    position, temperature, led = struct.unpack("<iBB", read(bench, servo_id, data, 6).params)
    assert position == bench.get(servo_id, t.POSITION) and temperature == bench.get(servo_id, t.TEMPERATURE)
    assert write(bench, servo_id, data + 5, b"\1") == "" and bench.get(servo_id, t.LED) == 1 and not led
    assert write(bench, servo_id, data, b"\0\0\0\0") == "access error", (
        "the write fails as it would on the register itself"
    )
    goal = range(t.GOAL_POSITION.address, t.GOAL_POSITION.address + 4)
    assert write(bench, servo_id, addresses, struct.pack("<4H", *goal)) == ""
    assert write(bench, servo_id, data, struct.pack("<i", 2100)) == ""
    assert bench.get(servo_id, t.GOAL_POSITION) == 2100
    assert write(bench, servo_id, data, b"\0\0") == "data length error"
    assert write(bench, servo_id, addresses, struct.pack("<H", 7)) == "data range error", (
        "an indirect address cannot be changed while torque is on"
    )
    assert write(bench, servo_id, addresses + 1, b"\0\0") == "data length error"
    raw(bench, servo_id, p.REBOOT, b"")
    assert read(bench, servo_id, addresses, 2).params == struct.pack("<H", data)


def test_there_are_no_registers_outside_the_table(bench: Bench) -> None:
    assert read(bench, XL330, 634, 1).failure == read(bench, XL430, 148, 1).failure == "access error"
    assert read(bench, XL330, 227, 2).failure == "access error"


def test_a_fast_bulk_read_answers_in_one_frame(bench: Bench) -> None:
    rows = [(1, t.MODEL.address, 2), (2, t.POSITION.address, 4), (5, t.TEMPERATURE.address, 1)]
    params = b"".join(struct.pack("<BHH", *row) for row in rows)
    (reply,) = bench.ask(p.frame(p.BROADCAST, p.FAST_BULK_READ, params))
    (packet,) = p.Decoder().feed(reply.data)
    assert packet.id == p.BROADCAST
    body = bytes((packet.error,)) + packet.params
    assert body[1] == 1 and struct.unpack_from("<H", body, 2)[0] == 1060
    assert body[7] == 2 and struct.unpack_from("<i", body, 8)[0] == bench.get(2, t.POSITION)
    assert body[15] == 5 and body[16] == bench.get(5, t.TEMPERATURE)
    bench.bus.set_fault(Fault.OFF, 1)
    assert bench.ask(p.frame(p.BROADCAST, p.FAST_BULK_READ, params)) == []


def test_a_factory_reset_keeps_the_selected_registers(bench: Bench) -> None:
    rate = t.BAUD_RATES.index(1_000_000)
    bench.put(2, t.RETURN_DELAY, 0)
    assert raw(bench, 2, p.FACTORY_RESET, b"\x02").failure == ""
    assert (bench.get(2, t.RETURN_DELAY), bench.get(2, t.BAUD)) == (250, rate)
    assert bench.get(2, t.MODE) == t.POSITION_MODE
    assert raw(bench, 2, p.FACTORY_RESET, b"\x01").failure == ""
    assert bench.get(2, t.BAUD) == t.BAUD_RATES.index(57_600)
    bench.bus.set_fault(Fault.OFF, 1)
    assert raw(bench, 2, p.FACTORY_RESET, b"\xff").id == 2
    assert bench.bus.servos[1].id == 1
    assert raw(bench, 3, p.FACTORY_RESET, b"\x07").failure == "data range error"
    assert raw(bench, 3, p.FACTORY_RESET, b"").failure == "data length error"


def test_turns_are_forgotten(bench: Bench) -> None:
    servo = bench.bus.servos[0]
    servo.zero_count += 4096
    start = bench.get(XL430, t.POSITION)
    assert start > 4095
    assert raw(bench, XL430, p.CLEAR, b"\x01\x44\x58\x4c\x22").failure == ""
    assert bench.get(XL430, t.POSITION) == start - 4096 == bench.get(XL430, t.GOAL_POSITION)
    assert raw(bench, XL430, p.CLEAR, b"\x01").failure == "data range error"


def test_its_clock_runs(bench: Bench) -> None:
    before = bench.get(1, t.REALTIME_TICK)
    bench.wait(0.5)
    assert 490 <= bench.get(1, t.REALTIME_TICK) - before <= 510
