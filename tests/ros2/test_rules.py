"""Pure rules: streams, units, and the messages that are made from readings."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.surfaces.mesh.outcome import Outcome
from strands_actors.surfaces.ros2 import answers, readings
from strands_actors.surfaces.ros2.commands import targets_of_joints, targets_of_numbers, targets_of_twist
from strands_actors.surfaces.ros2.diagnostics import LEVELS, Level, Summary, diagnostics
from strands_actors.surfaces.ros2.joints import Layout, layout_of
from strands_actors.surfaces.ros2.samples import Battery, Health, Imu, Odom, Presence, State, Wrench
from strands_actors.surfaces.ros2.streams import PAUSE_S, Delay, Sender, Streams

TTL_S = 0.1
MS = NS // 1000
ONE, TWO = Sender(b"1" * 16, "/one"), Sender(b"2" * 16, "/two")
UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
ARM = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


def code(answer: object) -> str:
    assert isinstance(answer, Refused), answer
    return answer.code


def layout(robot: str, *keys: str) -> Layout:
    found = layout_of(robot, keys)
    assert found is not None
    return found


# -- streams


def test_saf_009_one_stream_commands_until_it_has_paused() -> None:
    streams = Streams(TTL_S)
    assert streams.admit("/t", ONE, 0, 0) == TTL_S
    refused = streams.admit("/t", TWO, 10 * MS, 10 * MS)
    assert code(refused) == "lease" and isinstance(refused, Refused) and "/one" in refused.reason
    assert streams.admit("/t", ONE, 900 * MS, 900 * MS) == TTL_S
    assert code(streams.admit("/t", TWO, 1000 * MS, 1000 * MS)) == "lease"
    assert streams.admit("/t", TWO, 1900 * MS, 1900 * MS) == TTL_S


def test_saf_007_a_refused_stream_stays_refused_until_it_has_paused() -> None:
    streams = Streams(TTL_S)
    streams.admit("/t", ONE, 0, 0)
    streams.end("the robot is stopped")
    for ms in range(20, 5000, 20):
        assert code(streams.admit("/t", ONE, ms * MS, ms * MS)) == "stale_epoch"
    later_ns = 4980 * MS + round(PAUSE_S * NS)
    assert streams.admit("/t", ONE, later_ns, later_ns) == TTL_S


def test_saf_001_the_delay_of_a_message_is_taken_off_its_lifetime() -> None:
    streams, ahead_ns = Streams(TTL_S), 5_000_000 * NS  # the sender's clock is another one
    assert streams.admit("/t", ONE, ahead_ns, 0) == TTL_S
    left_s = streams.admit("/t", ONE, ahead_ns + 20 * MS, 60 * MS)
    assert left_s == pytest.approx(TTL_S - 0.04, abs=1e-4)
    assert code(streams.admit("/t", ONE, ahead_ns + 40 * MS, 400 * MS)) == "expired"


@given(st.lists(st.integers(0, 10_000), min_size=1, max_size=50), st.integers(-(10**18), 10**18))
def test_a_delay_is_never_negative_and_never_more_than_the_real_one(delays_us: list[int], offset_ns: int) -> None:
    delay = Delay()
    for index, late_us in enumerate(delays_us):
        sent_ns = index * 20 * MS
        estimate_s = delay.seconds(sent_ns + offset_ns, sent_ns + late_us * 1000)
        assert -1e-9 <= estimate_s <= late_us / 1e6 + 1e-6


def test_clocks_of_different_speed_are_no_delay() -> None:
    delay = Delay()
    for second in range(0, 36_000, 10):
        assert delay.seconds(second * NS, round(second * NS * (1 + 5e-5))) < 1e-3


# -- units


def test_degrees_and_percent_become_radians_and_back() -> None:
    arm = layout("so101", *ARM)
    joints = {joint.key: joint for joint in arm.joints}
    assert joints["shoulder_pan"].position(180.0) == pytest.approx(math.pi)
    closed, opened = joints["gripper"].position(0.0), joints["gripper"].position(100.0)
    assert (closed, opened) == pytest.approx((-0.174, 1.746), abs=0.01)  # the range of its model
    assert joints["gripper"].value(opened) == pytest.approx(100.0)


def test_axes_of_another_robot_are_not_guessed() -> None:
    assert layout_of("so101", ("a", "b")) is None
    assert layout_of("no such robot", ARM) is None


def test_a_walking_robot_is_found_by_its_axes() -> None:
    walking = layout("unitree_go2", "vx", "vy", "wz")
    assert set(walking.twist) == {("linear", "x"), ("linear", "y"), ("angular", "z")} and not walking.joints
    assert "imu" in walking.fields and "odom" in walking.fields


def test_speeds_without_an_si_unit_are_no_twist() -> None:
    rover = layout("earthrover", "linear", "angular", "lamp")
    assert not rover.twist
    assert not rover.fields["imu"]  # the rover's raw numbers


def twist(**values: float) -> dict[str, dict[str, float]]:
    zero = dict.fromkeys("xyz", 0.0)
    parts = {"linear": dict(zero), "angular": dict(zero)}
    for name, value in values.items():
        part, _, component = name.partition("_")
        parts[part][component] = value
    return parts


def test_a_twist_names_every_axis_of_the_base() -> None:
    base = layout("unitree_go2", "vx", "vy", "wz")
    targets = targets_of_twist("/t", twist(linear_x=0.2, angular_z=-0.1), base)
    assert targets == {"vx": 0.2, "vy": 0.0, "wz": -0.1}
    assert code(targets_of_twist("/t", twist(linear_z=0.2), base)) == "unknown_joint"


def test_positions_are_targets_in_the_units_of_the_driver() -> None:
    arm = layout("so101", *ARM)
    message = {"name": ["shoulder_pan"], "position": [math.pi / 2]}
    assert targets_of_joints("/t", message, arm) == {"shoulder_pan": pytest.approx(90.0)}
    assert code(targets_of_joints("/t", {"name": [], "position": []}, arm)) == "empty"
    assert code(targets_of_joints("/t", {"name": ["gripper"], "position": []}, arm)) == "malformed"
    twice = {"name": ["gripper", "gripper"], "position": [0.0, 0.0]}
    assert code(targets_of_joints("/t", twice, arm)) == "malformed"


def test_numbers_are_positions_of_all_joints_in_their_order() -> None:
    arm = layout("so101", *ARM)
    targets = targets_of_numbers("/t", {"data": [math.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0]}, arm)
    assert isinstance(targets, dict) and list(targets) == list(ARM)
    assert targets["shoulder_pan"] == pytest.approx(90.0)
    assert code(targets_of_numbers("/t", {"data": [0.0]}, arm)) == "malformed"


# -- readings


def test_saf_012_a_joint_state_has_the_time_of_its_reading_and_an_old_one_is_not_published() -> None:
    arm = layout("so101", *ARM)
    joints = dict.fromkeys(ARM, 90.0)
    message = readings.joint_state(State(1000.5, joints | {"gripper": None}, {}, 0.25), arm)
    assert message is not None
    assert message["header"]["stamp"] == {"sec": 1000, "nanosec": 250_000_000}
    assert message["name"] == list(ARM[:-1]) and message["velocity"] == []
    assert message["position"][0] == pytest.approx(math.pi / 2)
    assert readings.joint_state(State(1000.5, joints, {}, 3.0), arm) is None
    assert readings.joint_state(State(1000.5), arm) is None
    moving = readings.joint_state(State(1.0, joints, dict.fromkeys(ARM, 180.0), 0.0), arm)
    assert moving is not None and moving["velocity"][0] == pytest.approx(math.pi)


def test_efforts_are_published_if_one_joint_reports_one() -> None:
    arm = layout("so101", *ARM)
    joints = dict.fromkeys(ARM, 0.0)
    message = readings.joint_state(State(1.0, joints, {}, 0.0, {"wrist_roll": 1.5}), arm)
    assert message is not None and message["effort"][4] == 1.5 and math.isnan(message["effort"][0])
    silent = readings.joint_state(State(1.0, joints, {}, 0.0), arm)
    assert silent is not None and silent["effort"] == []


def test_a_wrench_has_three_forces_and_three_torques() -> None:
    sample = Wrench(1.0, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    message = readings.wrench(sample, layout("ur5e", *UR).fields["wrench"], "ur5e/base")
    assert message is not None and message["wrench"]["force"] == {"x": 1.0, "y": 2.0, "z": 3.0}
    assert message["wrench"]["torque"] == {"x": 4.0, "y": 5.0, "z": 6.0}
    assert readings.wrench(Wrench(1.0, [1.0]), frozenset({"wrench"}), "") is None


@given(st.binary(max_size=64))
def test_any_bytes_are_a_picture_with_a_size_or_none(data: bytes) -> None:
    for payload in (data, b"\xff\xd8\xff" + data):
        size = readings.jpeg_size(payload)
        assert size is None or len(size) == 2


def test_what_an_imu_does_not_measure_is_marked() -> None:
    sample = Imu(1.0, rpy=[0.0, 0.0, math.pi], gyro=[0.1, 0.2, 0.3])
    message = readings.imu(sample, frozenset({"rpy", "gyro"}), "go2/imu")
    assert message is not None
    assert message["orientation"]["z"] == pytest.approx(1.0)
    assert message["angular_velocity"] == {"x": 0.1, "y": 0.2, "z": 0.3}
    assert message["linear_acceleration_covariance"][0] == -1.0
    assert readings.imu(sample, frozenset(), "go2/imu") is None


def test_a_charge_is_a_fraction_and_the_rest_is_nan() -> None:
    message = readings.battery(Battery(1.0, pct=80.0), frozenset({"pct"}))
    assert message is not None and message["percentage"] == 0.8 and math.isnan(message["voltage"])
    assert readings.battery(Battery(1.0), frozenset({"pct"})) is None


def test_odometry_and_its_transform_agree() -> None:
    known = frozenset({"xy", "heading", "linear"})
    message = readings.odometry(Odom(1.0, xy=[1.0, 2.0], heading=math.pi, linear=0.5), known, "r/odom", "r/base")
    assert message is not None
    assert message["twist"]["twist"]["linear"] == {"x": 0.5, "y": 0.0, "z": 0.0}
    (transform,) = readings.transform(message)["transforms"]
    assert transform["transform"]["translation"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    assert transform["transform"]["rotation"]["z"] == pytest.approx(1.0)
    assert (transform["header"]["frame_id"], transform["child_frame_id"]) == ("r/odom", "r/base")
    assert readings.odometry(Odom(1.0), known, "r/odom", "r/base") is None


# -- answers and diagnostics


def test_every_mode_has_a_level() -> None:
    assert LEVELS.keys() == {str(mode) for mode in Mode}


def test_diagnostics_name_the_state_the_lock_and_the_fault() -> None:
    presence = Presence("so101", ARM, True, "disarmed", 4, "the red button", "")
    message = diagnostics("so101", Summary(presence, Health(), 0.1), 5.0)
    (status,) = message["status"]
    assert status["level"] == Level.WARN and "locked by the red button" in status["message"]
    faulty = Summary(presence, Health(faults={"gripper": "overload"}), 0.1)
    assert diagnostics("so101", faulty, 5.0)["status"][0]["level"] == Level.ERROR
    assert diagnostics("so101", Summary(), 5.0)["status"][0]["level"] == Level.ERROR


def test_saf_023_only_a_confirmed_stop_is_a_success() -> None:
    motors = ({"axis": "a", "safe": True}, {"axis": "b", "safe": False, "detail": "no answer"})
    unconfirmed = answers.of_stop(Outcome("r", "unconfirmed", motors=motors))
    assert not unconfirmed["success"] and "b NOT confirmed (no answer)" in unconfirmed["message"]
    assert not answers.of_stop(Outcome("r", "unreachable", "no answer"))["success"]
    confirmed = answers.of_stop(Outcome("r", "safe", safe_state="limp", took_ms=3.0, motors=motors[:1]))
    assert confirmed == {"success": True, "message": "r: limp, in 3.0 ms: a confirmed"}
