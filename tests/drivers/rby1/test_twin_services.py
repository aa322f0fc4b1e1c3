"""Test the vendor's unmodified rby1-sdk on what users' programs ask besides motions of joints: parameters, gains,
LED, time, log, tool flanges, models, links, springs and the base."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.drivers.common.twin_process import TwinProcess

from .test_twin_sdk import run

pytestmark = pytest.mark.needs("rby1-sdk")

READY = """
def command(body=None, head=None, base=None):
    whole = rb.ComponentBasedCommandBuilder()
    if body is not None:
        whole.set_body_command(body)
    if base is not None:
        whole.set_mobility_command(base)
    return rb.RobotCommandBuilder().set_command(whole)

def held(seconds):
    return rb.CommandHeaderBuilder().set_control_hold_time(seconds)

def bend():
    part = rb.BodyComponentBasedCommandBuilder()
    for set_arm, side in ((part.set_right_arm_command, -1), (part.set_left_arm_command, 1)):
        joints = rb.JointPositionCommandBuilder().set_minimum_time(1.0)
        set_arm(joints.set_position([0.2, 0.2 * side, 0.0, -1.0, 0.0, 0.7, 0.0]))
    assert robot.send_command(command(part), 1).get().finish_code == rb.RobotCommandFeedback.FinishCode.Ok

def place(link, reference="base", position=None):
    dynamics = robot.get_dynamics()
    state = dynamics.make_state([reference, link], robot.model().robot_joint_names)
    state.set_q(robot.get_state().position if position is None else position)
    dynamics.compute_forward_kinematics(state)
    return dynamics.compute_transformation(state, 0, 1)
"""


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[TwinProcess]:
    with TwinProcess(tmp_path, "rby1", "rby1") as process:
        yield process


def test_parameters_are_listed_set_and_reset(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
name = "joint_position_command.cutoff_frequency"
types = dict(robot.get_parameter_list())
values = [robot.get_parameter(name)]
set_ = [robot.set_parameter(name, "1"), robot.set_parameter(name, "1000"), robot.set_parameter(name, "fast")]
values.append(robot.get_parameter(name))
set_.append(robot.set_parameter("temp.parameter", "1", write_db=False))
set_.append(robot.set_parameter(name, "2", write_db=False))
values.append(robot.get_parameter(name))
reset = [robot.reset_parameter(name)]
values.append(robot.get_parameter(name))
reset.append(robot.factory_reset_parameter(name))
values.append(robot.get_parameter(name))
robot.set_parameter(name, "3")
reset.append(robot.reset_parameter_to_default(name))
values.append(robot.get_parameter(name))
robot.set_parameter(name, "4")
robot.factory_reset_all_parameters()
values.append(robot.get_parameter(name))
reset.append(robot.factory_reset_parameter("nonsense"))
try:
    robot.get_parameter("nonsense")
except RuntimeError as error:
    refused = str(error)
end(types=types, values=values, set=set_, reset=reset, refused=refused)
""",
    )
    assert reported["types"]["model_name"] == 2
    assert reported["types"]["default.se2_velocity_command.acceleration_limit"] == 3
    assert reported["types"]["battery_config"] == 5
    assert reported["values"] == ["15.0", "1.0", "2.0", "1.0", "15.0", "15.0", "15.0"]
    assert reported["set"] == [True, False, False, False, True]
    assert reported["reset"] == [True, True, True, False]
    assert "nonsense" in reported["refused"]


def test_gains_are_read_and_set_while_the_control_manager_is_idle(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
row = lambda gain: [gain.p_gain, gain.i_gain, gain.d_gain]
try:
    robot.get_torso_position_pid_gains()
except RuntimeError as error:
    refused = str(error)
assert robot.power_on(".*")
parts = [robot.get_torso_position_pid_gains(), robot.get_right_arm_position_pid_gains(),
         robot.get_left_arm_position_pid_gains(), robot.get_head_position_pid_gains()]
rows = [[row(gain) for gain in part] for part in parts]
before = robot.get_position_pid_gain("right_arm_3")
done = [robot.set_position_p_gain("right_arm_3", 100)]
after = [row(robot.get_position_pid_gain("right_arm_3"))]
done.append(robot.set_position_pid_gain("right_arm_3", rb.PIDGain(60, 10, 100)))
after.append(row(robot.get_position_pid_gain("right_arm_3")))
done.append(robot.set_position_pid_gain("right_arm_3", before))
after.append(row(robot.get_position_pid_gain("right_arm_3")))
done.append(robot.set_position_p_gain("nose", 1))
assert robot.servo_on(".*") and robot.enable_control_manager()
done.append(robot.set_position_p_gain("right_arm_3", 100))
end(refused=refused, rows=rows, done=done, after=after)
""",
    )
    assert "FAILED_PRECONDITION" in reported["refused"]
    assert [len(row) for row in reported["rows"]] == [6, 7, 7, 2]
    assert reported["rows"][0][1] == [1000, 38, 900]
    assert reported["done"] == [True, True, True, False, False]
    assert reported["after"] == [[100, 5, 80], [60, 10, 100], [35, 5, 80]]


def test_led_time_and_tool_flanges(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
from datetime import datetime, timezone
led = robot.set_led_color(rb.Color(255, 0, 0), duration=0.5, transition_time=0.1, blinking=True, blinking_freq=4)
set_ = [robot.set_system_time(datetime(2031, 2, 3, 4, 5, 6, tzinfo=timezone.utc), "Asia/Seoul")]
utc, local = robot.get_system_time()
set_.append(robot.set_system_time(datetime.now(), "Moon/Crater"))
stamp = robot.get_state().timestamp
synced = robot.sync_time()
volts = [robot.set_tool_flange_output_voltage("right", 24)]
assert robot.power_on(".*")
volts += [robot.set_tool_flange_output_voltage("right", 24), robot.set_tool_flange_output_voltage("middle", 24)]
outputs = [robot.set_tool_flange_digital_output("left", 1, True),
           robot.set_tool_flange_digital_output("left", 9, True),
           robot.set_tool_flange_digital_output_dual("right", True, False)]
state = robot.get_state()
right, left = state.tool_flange_right, state.tool_flange_left
assert robot.power_off("48v")
end(led=led, set=set_, utc=str(utc), local=local, year=str(stamp), synced=synced, volts=volts, outputs=outputs,
    right=[right.output_voltage, right.digital_output_A, right.digital_output_B],
    left=[left.output_voltage, left.digital_output_A, left.digital_output_B])
""",
    )
    assert (reported["led"], reported["synced"], reported["set"]) == (True, True, [True, False])
    assert reported["local"].startswith("2031-02-03 13:05:0") and "2031" in reported["year"]
    assert reported["volts"] == [False, True, False]
    assert reported["outputs"] == [True, False, True]
    assert (reported["right"], reported["left"]) == ([24, True, False], [0, False, True])


def test_the_battery_has_a_level_by_its_voltage_or_a_fixed_one(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
level = lambda: robot.get_state().battery_state.level_percent
levels = [level()]
done = [robot.set_battery_level(50.0), robot.set_battery_level(200.0)]
levels.append(level())
done.append(robot.set_battery_config(44.0, 58.0, [10.0, 1.0, 0.0, 0.0]))
levels.append(level())
done.append(robot.reset_battery_config())
levels.append(level())
end(levels=levels, done=done, volts=robot.get_state().battery_state.voltage)
""",
    )
    first, fixed, by_volts, again = reported["levels"]
    assert (fixed, by_volts, again) == (50.0, pytest.approx(10.0 + reported["volts"]), first)
    assert reported["done"] == [True, False, True, True]


def test_the_log_is_read_and_streamed_and_a_fault_leaves_a_file(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
import io
seen = []
robot.start_log_stream(lambda lines: seen.extend(line.message for line in lines), 20)
time.sleep(0.3)
assert robot.power_on(".*") and robot.servo_on(".*") and robot.enable_control_manager()
time.sleep(0.5)
robot.stop_log_stream()
last = [line.message for line in robot.get_last_log(2)]
faults = list(robot.get_fault_log_list())
end(seen=seen, last=last, faults=faults)
""",
    )
    assert reported["seen"] == ["PowerCommand", "JointCommand", "ControlManagerCommand"]
    assert reported["last"] == ["JointCommand", "ControlManagerCommand"]
    assert reported["faults"] == []
    twin.command("manager MAJOR_FAULT")
    reported = run(
        twin,
        """
import io
(name,) = robot.get_fault_log_list()
file = io.BytesIO()
robot.download_file(name, file)
end(content=file.getvalue().decode(), level=robot.get_last_log(1)[0].message)
""",
    )
    assert "MAJOR_FAULT,torso_0," in reported["content"]


def test_a_model_of_ones_own_is_in_use_after_a_restart(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
urdf = robot.get_robot_model()
mine = urdf.replace('<mass value="0.46704998"/>', '<mass value="0.96704998"/>')
imported = [robot.import_robot_model("heavier", mine), robot.import_robot_model("broken", "<robot/>")]
named = robot.set_parameter("model_name", '"heavier"')
end(tools=[name in urdf for name in ("ee_right", "ee_left", "link_torso_5")], changed=mine != urdf,
    imported=imported, named=named, now=robot.get_robot_model() == urdf)
""",
    )
    assert reported == {
        "tools": [True] * 3,
        "changed": True,
        "imported": [True, False],
        "named": True,
        "now": True,
    }
    twin.command("power-cycle")
    reported = run(twin, "end(heavier=robot.get_robot_model().count('0.96704998'))")
    assert reported == {"heavier": 2}


def test_a_hand_goes_where_the_vendors_own_kinematics_say(twin: TwinProcess) -> None:
    reported = run(
        twin,
        READY
        + """
energise()
bend()
begin = place("ee_right", "link_torso_5")
goal = begin.copy()
goal[:3, 3] += [0.05, -0.05, 0.1]
arm = rb.CartesianCommandBuilder().set_minimum_time(1.0).set_command_header(held(2.0))
arm.add_target("link_torso_5", "ee_right", goal, 1.5, 4.7, 1.0)
arm.set_stop_position_tracking_error(1e-4).set_stop_orientation_tracking_error(1e-3)
part = rb.BodyComponentBasedCommandBuilder().set_right_arm_command(arm)
stream = robot.create_command_stream(5)
stream.send_command(command(part))
errors = []
for _ in range(100):
    time.sleep(0.02)
    body = stream.request_feedback().component_based_command.body_command
    cartesian = body.body_component_based_command.right_arm_command.cartesian_command
    errors.append(cartesian.se3_pose_tracking_errors[0].position_error)
there = place("ee_right", "link_torso_5")
target = place("ee_right", "link_torso_5", robot.get_state().target_position)
stream.cancel()
end(errors=errors, manipulability=cartesian.manipulability,
    off=float(np.linalg.norm(there[:3, 3] - goal[:3, 3])),
    exact=float(np.abs(target - goal).max()), way=float(np.linalg.norm(begin[:3, 3] - goal[:3, 3])))
""",
    )
    assert reported["exact"] < 1e-3, "by the vendor's kinematics the targets of the joints give the commanded pose"
    assert reported["off"] < 0.02
    assert reported["errors"][0] > 0.08 and reported["errors"][-1] < 1e-3
    assert 1.0 < reported["manipulability"] < 1e4


def test_springs_of_joints_and_links(twin: TwinProcess) -> None:
    reported = run(
        twin,
        READY
        + """
energise()
bend()
finish = []
joints = rb.JointImpedanceControlCommandBuilder().set_command_header(held(0.5)).set_minimum_time(0.5)
joints.set_position([0.2, -0.4, 0.0, -1.2, 0.0, 0.7, 0.0]).set_stiffness([100.0] * 7).set_damping_ratio(1.0)
joints.set_torque_limit([30.0] * 7)
part = rb.BodyComponentBasedCommandBuilder().set_right_arm_command(joints)
finish.append(robot.send_command(command(part), 1).get().finish_code.name)
elbow = robot.get_state().position[11]
goal = place("ee_left", "link_torso_5")
goal[:3, 3] += [0.0, 0.0, 0.08]
link = rb.ImpedanceControlCommandBuilder().set_command_header(held(2.0)).set_reference_link_name("link_torso_5")
link.set_link_name("ee_left").set_translation_weight([1000] * 3).set_rotation_weight([50] * 3)
link.set_damping_ratio(0.85).set_transformation(goal)
part = rb.BodyComponentBasedCommandBuilder().set_left_arm_command(link)
handle = robot.send_command(command(part), 1)
time.sleep(1.8)
off = float(np.linalg.norm(place("ee_left", "link_torso_5")[:3, 3] - goal[:3, 3]))
finish.append(handle.get().finish_code.name)
cart = rb.CartesianImpedanceControlCommandBuilder().set_command_header(held(0.5)).set_minimum_time(0.5)
cart.add_target("link_torso_5", "ee_left", goal, 1.0, 3.0, 10.0, 30.0)
cart.set_joint_stiffness([100.0] * 7).set_joint_damping_ratio(1.0).set_joint_torque_limit([50.0] * 7)
part = rb.BodyComponentBasedCommandBuilder().set_left_arm_command(cart)
finish.append(robot.send_command(command(part), 1).get().finish_code.name)
free = rb.GravityCompensationCommandBuilder().set_command_header(held(0.3)).set_on(True)
part = rb.BodyComponentBasedCommandBuilder().set_left_arm_command(free)
finish.append(robot.send_command(command(part), 1).get().finish_code.name)
end(finish=finish, elbow=elbow, off=off)
""",
    )
    assert reported["finish"] == ["Ok"] * 4
    assert reported["elbow"] == pytest.approx(-1.2, abs=0.05)
    assert reported["off"] < 0.03


def test_the_base_moves_as_the_vendors_own_kinematics_say(twin: TwinProcess) -> None:
    reported = run(
        twin,
        READY
        + """
energise()
drive = rb.SE2VelocityCommandBuilder().set_command_header(held(1.0)).set_minimum_time(0.5)
handle = robot.send_command(command(base=drive.set_velocity([0.2, 0.1], 0.3)), 1)
time.sleep(1.0)
state = robot.get_state()
dynamics = robot.get_dynamics()
model = dynamics.make_state(["base"], robot.model().robot_joint_names)
model.set_q(np.zeros(24))
model.set_qdot(state.velocity)
dynamics.compute_forward_kinematics(model)
dynamics.compute_diff_forward_kinematics(model)
speed = [float(value) for value in np.ravel(dynamics.compute_mobility_diff_kinematics(model))]
finish = handle.get().finish_code.name
odometry = [[float(value) for value in row] for row in robot.get_state().odometry]
reset = robot.reset_odometry(0.5, np.array([1.0, 2.0]))
after = robot.get_state().odometry
end(finish=finish, wheels=list(state.velocity[:2]), speed=speed, odometry=odometry, reset=reset,
    after=[float(after[0][2]), float(after[1][2])])
""",
    )
    assert reported["finish"] == "Ok"
    turning, forwards, _ = reported["speed"]
    assert (forwards, turning) == pytest.approx((0.2, 0.3), abs=0.01), "the speed sideways is ignored"
    x = reported["odometry"][0][2]
    assert 0.15 < x < 0.3
    assert reported["reset"] is True
    assert reported["after"] == pytest.approx([1.0, 2.0], abs=0.02)


def test_commands_and_calls_that_are_not_modelled_are_refused(twin: TwinProcess) -> None:
    reported = run(
        twin,
        READY
        + """
energise()
errors = []
for call in (robot.scan_wifi, robot.get_serial_device_list, lambda: robot.set_preset_position("right_arm_6")):
    try:
        call()
    except RuntimeError as error:
        errors.append("UNIMPLEMENTED" in str(error))
unknown = rb.CartesianCommandBuilder().add_target("base", "ee_middle", np.eye(4), 1.0, 1.0, 1.0)
part = rb.BodyComponentBasedCommandBuilder().set_right_arm_command(unknown)
finish = robot.send_command(command(part), 1).get().finish_code.name
released = robot.brake_release("right_arm_3")
assert robot.disable_control_manager()
end(errors=errors, finish=finish, released=[released, robot.brake_release("right_arm_3")],
    engaged=robot.brake_engage("right_arm_3"))
""",
    )
    assert reported == {
        "errors": [True] * 3,
        "finish": "InitializationFailed",
        "released": [False, True],
        "engaged": True,
    }


def test_distances_of_links_are_those_of_the_vendors_own_library(twin: TwinProcess) -> None:
    reported = run(
        twin,
        READY
        + """
energise()
rows = []
for position in ([0.2, -0.2, 0.0, -1.0, 0.0, 0.7, 0.0], [0.8, -0.8, 0.7, -2.0, 0.0, 0.0, 0.0]):
    joints = rb.JointPositionCommandBuilder().set_minimum_time(1.0).set_position(position)
    part = rb.BodyComponentBasedCommandBuilder().set_right_arm_command(joints)
    assert robot.send_command(command(part), 1).get().finish_code == rb.RobotCommandFeedback.FinishCode.Ok
    time.sleep(0.5)
    state = robot.get_state()
    dynamics = robot.get_dynamics()
    links = list(dynamics.get_link_names())
    model = dynamics.make_state(links, robot.model().robot_joint_names)
    model.set_q(state.position)
    dynamics.compute_forward_kinematics(model)
    own = dynamics.detect_collisions_or_nearest_links(model, 5)
    row = lambda found: [[sorted((one.link1, one.link2)), one.distance] for one in found]
    rows.append([row(state.collisions), row(own)])
    center = dynamics.compute_center_of_mass(model, links.index("base"))
end(rows=rows, center=[float(x) for x in state.center_of_mass], own_center=[float(x) for x in np.ravel(center)])
""",
    )
    for ours, theirs in reported["rows"]:
        assert len(ours) == 5
        nearest = sorted(theirs, key=lambda row: row[1])
        for (links, distance), (other_links, other_distance) in zip(ours, nearest, strict=False):
            assert links == other_links
            assert distance == pytest.approx(other_distance, abs=2e-3)
    assert reported["rows"][1][0][0][1] < 0.03
    assert reported["center"] == pytest.approx(reported["own_center"], abs=0.02)
