"""Test the twin's servos in virtual time: the control table and its effect on the joints."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from strands_actors.drivers.common.dynamixel import protocol as p
from strands_actors.drivers.common.dynamixel import table as t
from strands_actors.drivers.common.twin import Fault, Reply
from strands_actors.drivers.dynamixel.robots import TABLES
from strands_actors.drivers.dynamixel.twin import DynamixelBus, main

IDS = range(1, 7)


class Bench:
    """A bus, its clock, and the registers of its servos."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.bus = DynamixelBus.for_robot("koch", lambda: self.now_s)

    def ask(self, frame: bytes) -> list[Reply]:
        return [reply for exchange in self.bus.receive(frame, None) for reply in exchange.replies]

    def status(self, frame: bytes) -> p.Packet:
        (reply,) = self.ask(frame)
        (packet,) = p.Decoder().feed(reply.data)
        return packet

    def get(self, servo_id: int, register: t.Register) -> int:
        return register.decode(self.status(p.read(servo_id, register.address, register.size)).params)

    def put(self, servo_id: int, register: t.Register, value: int) -> str:
        """Write a register. Return the servo's error."""
        return self.status(p.write(servo_id, register, value)).failure

    def wait(self, seconds: float, asking: int = 1) -> None:
        """Let time pass, as with a client that reads the robot at 100 Hz."""
        for _ in range(round(seconds * 100)):
            self.now_s += 0.01
            self.ask(p.ping(asking))

    def energise(self) -> None:
        for servo_id in IDS:
            self.put(servo_id, t.GOAL_POSITION, self.get(servo_id, t.POSITION))
            assert self.put(servo_id, t.TORQUE_ENABLE, 1) == ""

    def mode_3(self, servo_id: int) -> None:
        assert self.put(servo_id, t.MODE, t.POSITION_MODE) == ""


def test_the_servos_of_the_table_at_zero() -> None:
    bench = Bench()
    for joint in TABLES.table("koch")["joints"]:
        assert t.MODEL_NUMBERS[bench.get(joint["id"], t.MODEL)] == joint["model"]
        assert bench.get(joint["id"], t.VOLTAGE) == joint["voltage_v"] * 10
        assert bench.get(joint["id"], t.MODE) == joint["mode"]
        assert abs(bench.get(joint["id"], t.POSITION) - 2048) < 10
        assert bench.get(joint["id"], t.TORQUE_ENABLE) == 0
        assert bench.get(joint["id"], t.HARDWARE_ERROR) == 0


def test_an_unknown_robot_or_option_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"k0ch is not a Dynamixel robot\. Use one of koch"):
        TABLES.table("k0ch")
    with pytest.raises(ValueError, match="link, wire_time"):
        main("koch", options={"speed": 2})


def test_a_goal_moves_the_joint_only_with_torque() -> None:
    bench = Bench()
    bench.put(1, t.GOAL_POSITION, 2500)
    bench.wait(1)
    assert abs(bench.get(1, t.POSITION) - 2048) < 30
    bench.energise()
    bench.put(1, t.GOAL_POSITION, 2500)
    bench.wait(0.1)
    assert bench.get(1, t.MOVING) == 1
    assert bench.get(1, t.VELOCITY) > 0
    bench.wait(2)
    assert abs(bench.get(1, t.POSITION) - 2500) < 10
    assert bench.get(1, t.MOVING) == 0


def test_limp_lets_every_servo_go() -> None:
    bench = Bench()
    bench.energise()
    bench.put(2, t.GOAL_POSITION, 2048 - 300)
    bench.wait(2)
    assert bench.ask(p.LIMP) == []
    assert [bench.get(servo_id, t.TORQUE_ENABLE) for servo_id in IDS] == [0] * 6
    held = bench.get(2, t.POSITION)
    bench.wait(1)
    assert abs(bench.get(2, t.POSITION) - held) > 50, "the joint falls"


def test_mode_3_has_limits_and_the_others_have_turns() -> None:
    bench = Bench()
    bench.mode_3(1)
    bench.put(1, t.MAX_POSITION, 2200)
    assert bench.put(1, t.GOAL_POSITION, 2201) == "data limit error"
    assert bench.put(1, t.GOAL_POSITION, 2200) == ""
    assert bench.get(1, t.GOAL_POSITION) == 2200
    assert bench.put(2, t.GOAL_POSITION, -9000) == ""


def test_the_homing_offset_is_added_and_drive_mode_turns_round() -> None:
    bench = Bench()
    bench.put(1, t.HOMING_OFFSET, -100)
    assert abs(bench.get(1, t.POSITION) - 1948) < 5
    bench.put(1, t.DRIVE_MODE, 1)
    bench.energise()
    bench.put(1, t.GOAL_POSITION, 2148)
    bench.wait(2)
    assert abs(bench.get(1, t.POSITION) - 2148) < 10
    assert abs(bench.bus.plant.position_rad[0] + 200 * 2 * 3.14159 / 4096) < 0.02


def test_the_eeprom_is_locked_while_torque_is_on() -> None:
    bench = Bench()
    bench.energise()
    assert bench.put(1, t.RETURN_DELAY, 0) == "access error"
    assert bench.put(1, t.TORQUE_ENABLE, 0) == ""
    assert bench.put(1, t.RETURN_DELAY, 0) == ""
    bench.bus.power_cycle()
    assert bench.get(1, t.RETURN_DELAY) == 0, "the EEPROM keeps its value without power"


def test_error_numbers() -> None:
    bench = Bench()
    assert bench.put(1, t.TORQUE_ENABLE, 2) == "data range error"
    assert bench.put(1, t.POSITION, 5) == "access error"
    assert bench.status(p.frame(1, p.WRITE, b"\x74\x00\x01\x02")).failure == "data length error"
    assert bench.status(p.read(1, 140, 20)).failure == "access error"
    assert bench.status(p.frame(1, 0x44)).failure == "instruction error"
    assert bench.status(p.frame(1, p.ACTION)).failure == "instruction error"
    damaged = bytearray(p.read(1, 132, 4))
    damaged[-1] ^= 1
    assert bench.status(bytes(damaged)).failure == "CRC error"


def test_reboot_is_a_power_cycle_of_one() -> None:
    bench = Bench()
    bench.energise()
    assert bench.status(p.reboot(2)).failure == ""
    assert [bench.get(servo_id, t.TORQUE_ENABLE) for servo_id in IDS] == [1, 0, 1, 1, 1, 1]


def test_overload_lets_go_is_in_every_status_and_stays_until_a_reboot() -> None:
    bench = Bench()
    bench.energise()
    bench.put(6, t.GOAL_POSITION, 6000)  # far past the end of the jaw
    bench.wait(2)
    said = bench.status(p.read(6, t.HARDWARE_ERROR.address, 1))
    assert (said.alert, said.failure, t.error_words(said.params[0])) == (True, "", "overload")
    assert bench.get(6, t.TORQUE_ENABLE) == 0
    assert bench.status(p.torque(6, True)).error == p.ALERT | p.ACCESS_ERROR
    assert not bench.status(p.ping(1)).alert
    bench.status(p.reboot(6))
    assert bench.get(6, t.HARDWARE_ERROR) == 0
    assert bench.put(6, t.TORQUE_ENABLE, 1) == ""


def test_voltage_and_temperature_are_alerts_and_shutdown_selects_which_release() -> None:
    bench = Bench()
    bench.energise()
    bench.bus.servos[0].voltage_v = 5.0  # an XL430; its SHUTDOWN does not include this fault
    bench.bus.servos[2].voltage_v = 3.0  # an XL330; its SHUTDOWN includes it
    bench.bus.servos[3].temperature_c = 75
    bench.wait(0.1)
    assert [t.error_words(bench.get(i, t.HARDWARE_ERROR)) for i in (1, 3, 4)] == ["voltage", "voltage", "overheat"]
    assert [bench.get(i, t.TORQUE_ENABLE) for i in (1, 3, 4)] == [1, 0, 0]


# -- the bus watchdog


def test_silence_trips_the_bus_watchdog_where_the_joint_is() -> None:
    bench = Bench()
    bench.energise()
    assert bench.put(1, t.BUS_WATCHDOG, 5) == ""
    assert bench.get(1, t.BUS_WATCHDOG) == 5
    bench.put(1, t.GOAL_POSITION, 3300)
    bench.now_s += 0.3  # without a host the joint moves on for 0.1 s
    assert bench.get(1, t.BUS_WATCHDOG) == t.WATCHDOG_TRIPPED
    stopped = bench.get(1, t.POSITION)
    assert 2048 < stopped < 2048 + 0.3 * 6.39 * 652
    bench.wait(1)
    assert abs(bench.get(1, t.POSITION) - stopped) < 120, "the joint stays"
    assert bench.get(1, t.TORQUE_ENABLE) == 1


def test_a_tripped_servo_takes_no_goal_until_zero_is_written() -> None:
    bench = Bench()
    bench.energise()
    bench.put(1, t.BUS_WATCHDOG, 5)
    bench.now_s += 0.2
    assert bench.put(1, t.GOAL_POSITION, 0) == "data range error"
    assert bench.put(1, t.GOAL_VELOCITY, 0) == "data range error"
    assert bench.put(1, t.BUS_WATCHDOG, 5) == "data range error"
    bench.ask(p.hold({1: 2000}))
    bench.ask(p.goals({1: 2000}))
    assert bench.get(1, t.GOAL_POSITION) != 2000
    assert bench.put(1, t.BUS_WATCHDOG, 0) == ""
    assert bench.put(1, t.GOAL_POSITION, 2000) == ""


@pytest.mark.parametrize(
    "feed", [p.ping(1), p.read(1, 132, 4), p.sync_read([1], 132, 4), p.sync_write(t.LED, {1: 1})]
)
def test_any_instruction_for_the_servo_feeds_it(feed: bytes) -> None:
    bench = Bench()
    bench.energise()
    for servo_id in IDS:
        bench.put(servo_id, t.BUS_WATCHDOG, 5)
    for _ in range(20):
        bench.now_s += 0.05
        bench.ask(feed)
    assert [bench.get(servo_id, t.BUS_WATCHDOG) for servo_id in IDS] == [5, -1, -1, -1, -1, -1]


def test_without_torque_it_does_not_watch() -> None:
    bench = Bench()
    bench.put(1, t.BUS_WATCHDOG, 5)
    bench.now_s += 3
    assert bench.get(1, t.BUS_WATCHDOG) == 5


# -- the bus


def test_sync_read_answers_in_the_order_of_the_request_without_the_missing() -> None:
    bench = Bench()
    replies = bench.ask(p.sync_read([5, 99, 2, 1], t.POSITION.address, 4))
    assert [reply.unit for reply in replies] == [5, 2, 1]
    assert all(len(reply.data) == p.OVERHEAD + 4 for reply in replies)


def test_fast_sync_read_is_one_frame_that_ends_at_the_first_missing_servo() -> None:
    bench = Bench()
    (reply,) = bench.ask(p.fast_sync_read([1, 2, 3], t.MODEL.address, 2))
    (packet,) = p.Decoder().feed(reply.data)
    assert {i: a.params for i, a in p.fast_answers(packet, 2).items()} == {
        1: b"\x24\x04", 2: b"\x24\x04", 3: b"\xb0\x04"
    }  # fmt: skip
    (torn,) = bench.ask(p.fast_sync_read([1, 9, 3], t.MODEL.address, 2))
    assert list(p.Decoder().feed(torn.data)) == []
    assert bench.ask(p.fast_sync_read([9, 1], t.MODEL.address, 2)) == []


def test_bulk_read_and_write() -> None:
    bench = Bench()
    bench.ask(p.frame(p.BROADCAST, p.BULK_WRITE, bytes((1, 65, 0, 1, 0, 1, 2, 98, 0, 1, 0, 7))))
    replies = bench.ask(p.frame(p.BROADCAST, p.BULK_READ, bytes((2, 98, 0, 1, 0, 1, 65, 0, 1, 0))))
    assert [(reply.unit, reply.data[9]) for reply in replies] == [(2, 7), (1, 1)]


def test_only_a_broadcast_ping_is_answered_by_all() -> None:
    bench = Bench()
    assert [reply.unit for reply in bench.ask(p.ping(p.BROADCAST))] == list(IDS)
    assert bench.ask(p.read(p.BROADCAST, 132, 4)) == []
    assert bench.ask(p.frame(p.BROADCAST, p.ACTION)) == []


def test_reg_write_waits_for_action() -> None:
    bench = Bench()
    for servo_id in (1, 2):
        bench.status(p.frame(servo_id, p.REG_WRITE, bytes((t.LED.address, 0, 1))))
    assert (bench.get(1, t.LED), bench.get(1, t.REGISTERED)) == (0, 1)
    bench.ask(p.frame(p.BROADCAST, p.ACTION))
    assert [bench.get(servo_id, t.LED) for servo_id in (1, 2, 3)] == [1, 1, 0]


def test_status_level_and_rate_are_obeyed() -> None:
    bench = Bench()
    assert bench.ask(p.write(2, t.STATUS_LEVEL, 1)) == []
    assert bench.ask(p.write(2, t.LED, 1)) == []
    assert bench.get(2, t.LED) == 1
    assert bench.ask(p.write(3, t.STATUS_LEVEL, 0)) == []
    assert bench.ask(p.read(3, 65, 1)) == []
    assert len(bench.ask(p.ping(3))) == 1
    assert [reply.delay_s for reply in bench.ask(p.ping(1))] == [500e-6]
    bench.put(4, t.BAUD, 1)
    (ping,) = p.Decoder().feed(p.ping(4))
    assert bench.bus.handle(ping, 1_000_000) == []
    assert len(bench.bus.handle(ping, 57_600)) == 1


def test_a_servo_without_power_neither_receives_nor_holds_and_restarts_as_new() -> None:
    bench = Bench()
    bench.energise()
    bench.bus.set_fault(Fault.OFF, 2)
    assert bench.ask(p.ping(2)) == []
    assert not bench.bus.plant.torque(1)
    bench.bus.set_fault(Fault.OK, 2)
    assert bench.get(2, t.TORQUE_ENABLE) == 0


def test_stuck_and_wrong() -> None:
    bench = Bench()
    bench.energise()
    bench.bus.set_fault(Fault.STUCK, 1)
    felt = bench.get(1, t.POSITION)
    bench.put(1, t.GOAL_POSITION, 1800)
    bench.wait(0.5)
    assert bench.get(1, t.POSITION) == felt
    bench.bus.set_fault(Fault.WRONG, 2)
    assert bench.get(2, t.POSITION) > 2048 + 1900


requests = st.one_of(
    st.builds(
        p.frame,
        st.sampled_from([1, 2, 6, 99, p.BROADCAST]),
        st.sampled_from([1, 2, 3, 4, 5, 6, 8, 0x10, 0x82, 0x83, 0x8A, 0x92, 0x93, 0x9A, 0x55]),
        st.binary(max_size=16),
    ),
    st.binary(max_size=20),
)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(requests, st.floats(0, 0.1)), max_size=8))
def test_no_request_breaks_the_twin(sent: list[tuple[bytes, float]]) -> None:
    bench = Bench()
    for frame, pause_s in sent:
        bench.now_s += pause_s
        for reply in bench.ask(frame):
            assert reply.data.startswith(p.HEADER)
    bench.bus.power_cycle()
    assert len(bench.ask(p.ping(p.BROADCAST))) <= len(bench.bus.servos)
