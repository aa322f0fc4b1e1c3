"""Test the twin's servos in virtual time: the control table and its effect on the joints."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from strands_actors.drivers.common.twin import Fault, Reply
from strands_actors.drivers.common.twin.servo_bus import TORN_FRAME_S
from strands_actors.drivers.feetech import protocol as p
from strands_actors.drivers.feetech.robots import TABLES
from strands_actors.drivers.feetech.twin import FeetechBus, main


class Bench:
    """A bus, its clock, and the registers of its servos."""

    def __init__(self, robot: str = "so101", goal_energises: bool = True) -> None:
        self.now_s = 0.0
        self.bus = FeetechBus.for_robot(robot, lambda: self.now_s, goal_energises)

    def ask(self, frame: bytes) -> list[Reply]:
        return [reply for exchange in self.bus.receive(frame, None) for reply in exchange.replies]

    def status(self, frame: bytes) -> p.Packet:
        (reply,) = self.ask(frame)
        (packet,) = p.Decoder().feed(reply.data)
        return packet

    def get(self, servo_id: int, register: p.Register) -> int:
        return register.decode(self.status(p.read(servo_id, register.address, register.size)).params)

    def put(self, servo_id: int, register: p.Register, value: int) -> p.Packet:
        return self.status(p.write(servo_id, register, value))

    def wait(self, seconds: float) -> None:
        """Let time pass, as with a client that reads the robot at 100 Hz."""
        for _ in range(round(seconds * 100)):
            self.now_s += 0.01
            self.ask(p.ping(1))

    def energise(self) -> None:
        for servo in self.bus.servos:
            self.put(servo.id, p.GOAL_POSITION, self.get(servo.id, p.POSITION))
            self.put(servo.id, p.TORQUE_ENABLE, 1)


@pytest.mark.parametrize("robot", ["so100", "so101", "hope_jr", "open_duck_mini", "so101_follower"])
def test_every_robot_has_its_servos_at_zero(robot: str) -> None:
    bench = Bench(robot)
    for joint in TABLES.table(robot)["joints"]:
        assert p.MODEL_NUMBERS[bench.get(joint["id"], p.MODEL)] == joint["model"]
        assert bench.get(joint["id"], p.POSITION) == 2048
        assert bench.get(joint["id"], p.TORQUE_ENABLE) == 0
        assert bench.get(joint["id"], p.STATUS) == 0


def test_an_unknown_robot_or_option_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="Use one of so100, so101"):
        TABLES.table("so102")
    with pytest.raises(ValueError, match="link, wire_time"):
        main("so101", options={"speed": 2})


def test_a_goal_turns_the_torque_on_as_on_a_real_servo() -> None:
    bench = Bench()
    bench.put(1, p.GOAL_POSITION, 2500)
    bench.ask(p.goals({2: 2300}))
    assert [bench.get(motor, p.TORQUE_ENABLE) for motor in range(1, 7)] == [1, 1, 0, 0, 0, 0]
    bench.wait(2)
    assert abs(bench.get(1, p.POSITION) - 2500) < 30
    bench.ask(p.LIMP)
    assert bench.get(1, p.TORQUE_ENABLE) == 0
    bench.put(1, p.TORQUE_LIMIT, 500)
    assert bench.get(1, p.TORQUE_ENABLE) == 0, "only a goal turns the torque on"


def test_a_goal_moves_the_joint_only_with_torque() -> None:
    bench = Bench(goal_energises=False)
    bench.put(1, p.GOAL_POSITION, 2500)
    bench.wait(1)
    assert abs(bench.get(1, p.POSITION) - 2048) < 30
    assert bench.get(1, p.TORQUE_ENABLE) == 0
    bench.energise()
    bench.put(1, p.GOAL_POSITION, 2500)
    bench.wait(0.1)
    assert bench.get(1, p.MOVING) == 1
    assert bench.get(1, p.VELOCITY) > 0
    assert bench.get(1, p.LOAD) != 0
    bench.wait(2)
    assert abs(bench.get(1, p.POSITION) - 2500) < 5
    assert bench.get(1, p.MOVING) == 0


def test_broadcast_torque_off_lets_every_servo_go() -> None:
    bench = Bench()
    bench.energise()
    bench.put(2, p.GOAL_POSITION, 2048 - 300)
    bench.wait(2)
    assert bench.ask(p.LIMP) == []
    assert [bench.get(servo_id, p.TORQUE_ENABLE) for servo_id in range(1, 7)] == [0] * 6
    held = bench.get(2, p.POSITION)
    bench.wait(1)
    assert bench.get(2, p.POSITION) - held > 50  # it falls


def test_goals_are_clamped_to_the_position_limits_with_the_homing_offset() -> None:
    bench = Bench()
    bench.put(1, p.MAX_POSITION, 2200)
    bench.put(1, p.HOMING_OFFSET, -100)
    assert bench.get(1, p.POSITION) == 2148
    bench.energise()
    bench.put(1, p.GOAL_POSITION, 3000)
    bench.wait(2)
    assert abs(bench.get(1, p.POSITION) - 2200) < 5
    assert abs(bench.bus.plant.position_rad[0] - (2100 - 2048) * 2 * 3.14159 / 4096) < 0.01
    assert bench.get(1, p.GOAL_POSITION) == 3000


def test_a_position_below_zero_wraps_unless_the_servo_reports_turns() -> None:
    bench = Bench()
    bench.put(1, p.MIN_POSITION, 0)
    bench.put(1, p.HOMING_OFFSET, 2047)
    assert bench.get(1, p.POSITION) == 1
    bench.bus.plant.data.joint("shoulder_pan").qpos[0] = -0.1
    assert bench.get(1, p.POSITION) == 4096 + 1 - 65
    bench.put(1, p.PHASE, 0x10)
    assert bench.get(1, p.POSITION) == 1 - 65


def test_128_makes_the_present_position_the_middle() -> None:
    bench = Bench()
    bench.energise()
    bench.put(1, p.GOAL_POSITION, 2300)
    bench.wait(2)
    bench.put(1, p.TORQUE_ENABLE, p.SET_MIDDLE)
    assert abs(bench.get(1, p.POSITION) - 2048) <= 1
    assert abs(bench.get(1, p.HOMING_OFFSET) - 252) < 5
    assert bench.get(1, p.TORQUE_ENABLE) == 0


def test_eeprom_survives_only_what_was_written_unlocked() -> None:
    bench = Bench()
    assert bench.get(3, p.LOCK) == 1
    bench.put(3, p.P_GAIN, 16)
    bench.put(3, p.LOCK, 0)
    bench.put(3, p.D_GAIN, 8)
    bench.put(3, p.GOAL_POSITION, 2100)
    bench.bus.power_cycle()
    assert bench.get(3, p.P_GAIN) == 32
    assert bench.get(3, p.D_GAIN) == 8
    assert bench.get(3, p.LOCK) == 1
    assert bench.get(3, p.GOAL_POSITION) == bench.get(3, p.POSITION)  # RAM is reset


def test_an_id_written_unlocked_is_the_id_from_then_on() -> None:
    bench = Bench()
    bench.put(6, p.LOCK, 0)
    assert bench.put(6, p.ID, 16).id == 6
    assert bench.ask(p.ping(6)) == []
    bench.bus.power_cycle()
    assert bench.status(p.ping(16)).id == 16
    assert bench.status(p.frame(16, p.RESET)).id == 16


def test_reboot_is_a_power_cycle_of_one() -> None:
    bench = Bench()
    bench.energise()
    bench.status(p.frame(2, p.REBOOT))
    assert [bench.get(servo_id, p.TORQUE_ENABLE) for servo_id in range(1, 7)] == [1, 0, 1, 1, 1, 1]


def test_read_only_registers_and_the_end_of_the_table_are_safe() -> None:
    bench = Bench()
    bench.put(1, p.POSITION, 5)
    bench.put(1, p.MODEL, 5)
    assert bench.get(1, p.POSITION) == 2048
    assert bench.get(1, p.MODEL) == 777
    assert bench.status(p.read(1, 85, 20)).params[5:] == bytes(15)
    assert len(bench.status(p.read(1, 250, 200)).params) == 200
    bench.status(p.frame(1, p.WRITE, bytes((88, 1, 2, 3, 4))))
    assert bench.status(p.read(1, 88, 4)).params == bytes((1, 2, 0, 0))


def test_sync_read_answers_in_the_order_of_the_request_without_the_missing() -> None:
    bench = Bench()
    replies = bench.ask(p.sync_read([5, 99, 2, 1], p.POSITION.address, 2))
    assert [reply.unit for reply in replies] == [5, 2, 1]
    assert all(len(reply.data) == 8 for reply in replies)


def test_only_a_broadcast_ping_is_answered_by_all() -> None:
    bench = Bench()
    assert [reply.unit for reply in bench.ask(p.ping(p.BROADCAST))] == [1, 2, 3, 4, 5, 6]
    assert bench.ask(p.read(p.BROADCAST, 56, 2)) == []
    assert bench.ask(p.frame(p.BROADCAST, p.ACTION)) == []


def test_reg_write_waits_for_action() -> None:
    bench = Bench()
    for servo_id in (1, 2):
        bench.status(p.frame(servo_id, p.REG_WRITE, bytes((p.ACCELERATION.address, 7))))
    assert bench.get(1, p.ACCELERATION) == 0
    bench.ask(p.frame(p.BROADCAST, p.ACTION))
    assert [bench.get(servo_id, p.ACCELERATION) for servo_id in (1, 2, 3)] == [7, 7, 0]


def test_return_delay_and_status_level_are_obeyed() -> None:
    bench = Bench()
    assert [reply.delay_s for reply in bench.ask(p.ping(1))] == [500e-6]
    bench.put(1, p.RETURN_DELAY, 0)
    assert [reply.delay_s for reply in bench.ask(p.ping(1))] == [0]
    bench.put(2, p.STATUS_LEVEL, 1)
    assert bench.ask(p.write(2, p.STATUS_LEVEL, 0)) == []
    assert bench.ask(p.write(2, p.ACCELERATION, 9)) == []
    assert bench.get(2, p.ACCELERATION) == 9


def test_a_servo_at_another_rate_receives_nothing() -> None:
    bench = Bench()
    bench.put(4, p.BAUD, 1)
    (ping,) = p.Decoder().feed(p.ping(4))
    assert bench.bus.handle(ping, 1_000_000) == []
    assert len(bench.bus.handle(ping, 500_000)) == 1
    bench.put(4, p.BAUD, 200)
    assert bench.bus.handle(ping, 500_000) == []


def test_voltage_and_temperature_out_of_bounds_show_in_the_error_byte() -> None:
    bench = Bench()
    bench.bus.servos[0].voltage_v = 3.9
    bench.bus.servos[1].temperature_c = 75
    assert p.error_words(bench.status(p.ping(1)).code) == "voltage"
    assert p.error_words(bench.status(p.ping(2)).code) == "overheat"
    assert (bench.get(1, p.VOLTAGE), bench.get(2, p.TEMPERATURE)) == (39, 75)
    assert bench.status(p.ping(3)).code == 0


def test_an_overload_releases_the_servo_until_torque_is_written() -> None:
    bench = Bench()
    bench.energise()
    bench.put(6, p.GOAL_POSITION, 0)  # far past the end of the jaw
    bench.wait(1)
    assert bench.get(6, p.TORQUE_ENABLE) == 1
    assert abs(bench.get(6, p.LOAD)) > 900
    bench.wait(2)
    assert bench.get(6, p.TORQUE_ENABLE) == 0
    assert p.error_words(bench.status(p.ping(6)).code) == "overload"
    assert bench.get(1, p.TORQUE_ENABLE) == 1
    bench.put(6, p.GOAL_POSITION, 2048)
    bench.put(6, p.TORQUE_ENABLE, 1)
    bench.wait(3)
    assert bench.status(p.ping(6)).code == 0
    assert abs(bench.get(6, p.POSITION) - 2048) < 10


@pytest.mark.parametrize("torque", [False, True])
def test_a_servo_is_overloaded_only_by_its_own_motor(torque: bool) -> None:
    """A hand, which is a simulation here, presses the jaw against its stop."""
    bench = Bench()
    if torque:
        bench.energise()
        bench.put(6, p.GOAL_POSITION, 0)
    plant = bench.bus.plant
    plant.energise(5, True)
    plant.set_simulation_target(5, -3.0)
    bench.wait(4)
    assert abs(bench.get(6, p.POSITION) - 2048) > 50, "it is moved to its stop"
    assert p.error_words(bench.status(p.ping(6)).code) == ("overload" if torque else "")
    assert bench.get(6, p.LOAD) == 0 and bench.get(6, p.CURRENT) == 0


def test_the_load_of_two_moments_with_silence_between_is_no_overload() -> None:
    bench = Bench()
    bench.energise()
    bench.put(1, p.GOAL_POSITION, 800)
    bench.wait(0.05)
    assert abs(bench.get(1, p.LOAD)) > 900, "it accelerates"
    bench.now_s += 10.0  # of which the plant simulates 0.25 s
    assert abs(bench.get(1, p.LOAD)) > 900, "it still does"
    assert bench.status(p.ping(1)).code == 0
    bench.wait(1)
    assert bench.get(1, p.TORQUE_ENABLE) == 1 and abs(bench.get(1, p.POSITION) - 800) < 10


def test_the_torque_limit_limits() -> None:
    bench = Bench()
    bench.put(6, p.TORQUE_LIMIT, 300)
    bench.energise()
    bench.put(6, p.GOAL_POSITION, 0)
    bench.wait(4)
    assert abs(bench.get(6, p.LOAD)) == 300
    assert bench.get(6, p.TORQUE_ENABLE) == 1  # under the overload threshold


def test_a_servo_without_power_neither_receives_nor_holds_and_restarts_as_new() -> None:
    bench = Bench()
    bench.energise()
    bench.bus.set_fault(Fault.OFF, 2)
    assert bench.ask(p.ping(2)) == []
    assert [reply.unit for reply in bench.ask(p.sync_read([1, 2, 3], 56, 2))] == [1, 3]
    bench.ask(p.sync_write(p.TORQUE_ENABLE, {2: 1}))
    assert not bench.bus.plant.torque(1)
    assert bench.bus.plant.torque(0)
    bench.bus.set_fault(Fault.OK, 2)
    assert bench.get(2, p.TORQUE_ENABLE) == 0


def test_a_stuck_servo_repeats_its_last_reading_and_does_not_move() -> None:
    bench = Bench()
    bench.energise()
    bench.put(1, p.GOAL_POSITION, 2200)
    bench.wait(2)
    bench.bus.set_fault(Fault.STUCK, 1)
    felt = bench.status(p.read(1, 56, 15)).params
    bench.put(1, p.GOAL_POSITION, 1800)
    bench.wait(1)
    assert bench.status(p.read(1, 56, 15)).params == felt
    assert abs(bench.bus.plant.position_rad[0] - 0.233) < 0.02
    bench.bus.set_fault(Fault.OK)
    bench.wait(2)
    assert abs(bench.get(1, p.POSITION) - 1800) < 5


def test_wrong_is_half_a_turn_away_in_a_frame_that_looks_right() -> None:
    bench = Bench()
    bench.bus.set_fault(Fault.WRONG, 1)
    assert (bench.get(1, p.POSITION), bench.get(2, p.POSITION)) == (0, 2048)
    bench.bus.set_fault(Fault.OK)
    assert bench.get(1, p.POSITION) == 2048


def test_a_torn_frame_does_not_swallow_the_next_one() -> None:
    bench = Bench()
    assert bench.ask(b"\xff\xff\x01\xf0\x03") == []
    bench.now_s += TORN_FRAME_S * 2
    assert len(bench.ask(p.ping(1))) == 1


requests = st.one_of(
    st.builds(
        p.frame,
        st.sampled_from([1, 2, 6, 99, p.BROADCAST]),
        st.sampled_from([1, 2, 3, 4, 5, 6, 8, 0x82, 0x83, 0x55]),
        st.binary(max_size=12),
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
            assert len(list(p.Decoder().feed(reply.data))) == 1
    bench.bus.power_cycle()
    assert len(bench.ask(p.ping(p.BROADCAST))) <= len(bench.bus.servos)


def test_the_table_is_as_delivered() -> None:
    bench = Bench()
    delivered = {
        p.MAX_VOLTAGE: 80,
        p.MIN_VOLTAGE: 40,
        p.PHASE: 12,
        p.UNLOAD_CONDITION: 44,
        p.LED_ALARM: 47,
        p.MIN_START_FORCE: 16,
        p.CLOCKWISE_DEAD_ZONE: 1,
        p.COUNTER_DEAD_ZONE: 1,
        p.PROTECTION_CURRENT: 500,
        p.ANGULAR_RESOLUTION: 1,
        p.PROTECTIVE_TORQUE: 20,
        p.OVERCURRENT_TIME: 200,
        p.VELOCITY_P: 10,
        p.VELOCITY_I: 10,
    }
    assert {register: bench.get(2, register) for register in delivered} == delivered
    assert Bench("hope_jr").get(2, p.MAX_VOLTAGE) == 140, "a servo for 12 V allows a higher voltage"


def test_goal_velocity_limits_the_speed_on_the_way_to_a_goal() -> None:
    bench = Bench()
    bench.put(1, p.GOAL_VELOCITY, 200)
    bench.put(1, p.GOAL_POSITION, 2648)
    bench.wait(1.0)
    assert 2150 < bench.get(1, p.POSITION) < 2300
    bench.put(1, p.GOAL_POSITION, 1800)  # on the way, from the present position
    bench.wait(1.0)
    assert 1950 < bench.get(1, p.POSITION) < 2150
    bench.put(1, p.GOAL_VELOCITY, 0)
    bench.wait(1.5)
    assert abs(bench.get(1, p.POSITION) - 1800) < 30, "without a goal velocity the servo moves at full speed"


def test_velocity_mode_turns_until_another_command() -> None:
    bench = Bench()
    bench.put(1, p.MODE, p.VELOCITY_MODE)
    bench.put(1, p.GOAL_VELOCITY, 300)
    bench.put(1, p.TORQUE_ENABLE, 1)
    bench.wait(1.0)
    assert 2250 < bench.get(1, p.POSITION) < 2400
    assert 200 < bench.get(1, p.VELOCITY) < 400
    bench.put(1, p.GOAL_VELOCITY, -300)
    bench.wait(1.0)
    assert 1950 < bench.get(1, p.POSITION) < 2150
    bench.put(1, p.GOAL_VELOCITY, 0)
    bench.wait(0.3)
    stood = bench.get(1, p.POSITION)
    bench.wait(0.5)
    assert abs(bench.get(1, p.POSITION) - stood) < 5
    bench.put(1, p.GOAL_VELOCITY, 300)
    bench.ask(p.LIMP)
    assert not bench.bus.servos[0].rate_rad_s


def test_with_bit_2_of_the_phase_off_a_speed_counts_fifty_counts_a_second() -> None:
    bench = Bench()
    bench.put(1, p.PHASE, bench.get(1, p.PHASE) & ~p.SPEED_IN_COUNTS)
    bench.put(1, p.MODE, p.VELOCITY_MODE)
    bench.put(1, p.GOAL_VELOCITY, 6)
    bench.put(1, p.TORQUE_ENABLE, 1)
    bench.wait(1.0)
    assert 2250 < bench.get(1, p.POSITION) < 2400
    assert 4 <= bench.get(1, p.VELOCITY) <= 8


def test_step_mode_and_power_mode() -> None:
    bench = Bench()
    bench.put(1, p.MODE, p.STEP_MODE)
    for _ in range(2):
        bench.put(1, p.GOAL_POSITION, 150)
        bench.wait(1.0)
    assert abs(bench.get(1, p.POSITION) - 2348) < 30
    bench.put(1, p.GOAL_POSITION, -300)
    bench.wait(1.0)
    assert abs(bench.get(1, p.POSITION) - 2048) < 30
    bench.put(1, p.MODE, p.PWM_MODE)
    bench.put(1, p.GOAL_TIME, -400)
    bench.wait(0.5)
    assert bench.get(1, p.POSITION) < 1950


def test_a_joint_that_is_held_is_not_led_away_from() -> None:
    bench = Bench()
    bench.put(1, p.GOAL_VELOCITY, 400)
    bench.put(1, p.GOAL_POSITION, 3000)
    bench.bus.set_fault(Fault.STUCK, 1)
    bench.wait(2.0)
    bench.bus.set_fault(Fault.OK, 1)
    bench.wait(0.2)
    assert bench.get(1, p.POSITION) < 2500, "the goal does not jump ahead for the time that the joint was held"


def test_other_faults_do_not_release_the_servo() -> None:
    bench = Bench()
    bench.energise()
    bench.bus.servos[0].temperature_c = 75
    bench.wait(0.1)
    assert bench.get(1, p.TORQUE_ENABLE) == 0
    bench.put(2, p.UNLOAD_CONDITION, 0)
    bench.bus.servos[1].temperature_c = 75
    bench.wait(0.1)
    assert bench.get(2, p.TORQUE_ENABLE) == 1
