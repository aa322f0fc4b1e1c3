"""Test the vendor's unmodified xarm-python-sdk against the twin, in separate processes, because it changes the
default timeout of every socket of its process, and prints to standard output."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.answers import PATIENCE_S
from tests.drivers.common.twin_process import TwinProcess

PRELUDE = """
import json, sys, time
from xarm.core.config.x_config import XCONF
from xarm.wrapper import XArmAPI

XCONF.SocketConf.TCP_CONTROL_PORT = int(sys.argv[2])  # 502 where this user may have it

def arm(host=sys.argv[1], **options):
    return XArmAPI(host, is_radian=True, **options)

def until(look):
    deadline = time.monotonic() + 15
    while not look():
        assert time.monotonic() < deadline, "patience is over"
        time.sleep(0.01)

def ready(arm, mode):
    assert arm.motion_enable(True) == 0 and arm.set_mode(mode) == 0 and arm.set_state(0) == 0
    until(lambda: arm.mode == mode and arm.state == 2)

def servo(arm):
    ready(arm, 1)
    return arm.get_servo_angle(is_real=True)[1]

def end(**told):
    print(json.dumps(told), flush=True)
"""


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TwinProcess]:
    with TwinProcess(tmp_path_factory.mktemp("twin"), "xarm7", "xarm") as process:
        yield process


def run(twin: TwinProcess, program: str, *more: str) -> dict[str, Any]:
    """Return the result that the program prints at its end."""
    ran = subprocess.run(
        [sys.executable, "-c", PRELUDE + program, *twin.port.split(":"), *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=3 * PATIENCE_S,
    )
    lines = [line for line in ran.stdout.splitlines() if line.startswith("{")]
    assert ran.returncode == 0 and lines, ran.stdout
    reported: dict[str, Any] = json.loads(lines[-1])
    return reported


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("report", ["rich", "normal", "real"])
def test_it_connects_hears_reports_of_each_kind_and_moves_the_arm(twin: TwinProcess, report: str) -> None:
    reported = run(
        twin,
        f"""
xarm = arm(report_type={report!r})
heard = []
xarm.register_report_location_callback(lambda item: heard.append(item))
until(lambda: len(heard) > 3)
q = servo(xarm)
for at in range(50):
    assert xarm.set_servo_angle_j([q[0] + 0.004 * (at + 1), *q[1:]]) == 0
    time.sleep(0.01)
until(lambda: abs(xarm.angles[0] - q[0] - 0.2) < 0.01)
states = xarm.get_joint_states()[1]
assert xarm.set_mode(0) == 0 and xarm.set_state(0) == 0
until(lambda: xarm.mode == 0)
back = xarm.set_servo_angle(angle=q, speed=1.0, wait=True, timeout=10)
there = xarm.get_servo_angle()[1][0] - q[0]
xarm.emergency_stop()
end(version=xarm.version, sn=xarm.sn, axis=xarm.axis, type=xarm.device_type, q=q, states=len(states), back=back,
    there=there, state=xarm.state, limit=xarm.joint_speed_limit, codes=[xarm.error_code, xarm.warn_code])
""",
    )
    assert reported["version"].endswith(",v1.12.10")
    assert (reported["sn"], reported["axis"], reported["type"]) == ("XF1300012345", 7, 7)
    assert reported["states"] == 3
    assert reported["back"] == 0 and abs(reported["there"]) < 0.01
    assert reported["state"] == 4 and reported["codes"] == [0, 0]
    if report == "rich":
        assert reported["limit"] == pytest.approx([1e-4, 3.14159]), (
            "the SDK reads the limit at the same place as our driver"
        )


def test_a_jump_is_an_error_that_it_reads_and_clears(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
xarm = arm(report_type="real")
q = servo(xarm)
jumped = xarm.set_servo_angle_j([q[0] + 1.0, *q[1:]])
again = xarm.set_servo_angle_j(q)
codes = xarm.get_err_warn_code()
xarm.clean_error()
servo(xarm)
xarm.set_state(4)
end(jumped=jumped, again=again, codes=codes, cleared=xarm.get_err_warn_code(), state=xarm.get_state()[1])
""",
    )
    assert reported["jumped"] == reported["again"] == 1
    assert reported["codes"] == [0, [24, 0]] and reported["cleared"] == [0, [0, 0]]
    assert reported["state"] == 4


def test_what_it_does_not_model_is_code_10_and_never_an_exception(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
xarm = arm(report_type="real")
q = servo(xarm)
codes = dict(
    record=xarm.start_record_trajectory(),
    dh=xarm.get_dh_params()[0],
    load=xarm.iden_tcp_load()[0],
    force=xarm.get_ft_sensor_data()[0],
    rebound=xarm.set_collision_rebound(True)[0],
    delayed=xarm.set_cgpio_digital(0, 1, delay_sec=1),
    line=xarm.set_position(x=300, y=0, z=300, roll=3.14, pitch=0, yaw=0, wait=False),
    wrong_mode=xarm._arm.arm_cmd.move_joint(q, 0.5, 10, 0)[0],
)
xarm.set_state(4)
end(codes=codes, linear=xarm.get_linear_motor_pos()[0], error=xarm.get_err_warn_code())
""",
    )
    assert set(reported["codes"].values()) == {10}, reported
    assert reported["linear"] == 22, "no linear motor answers at any baud rate"
    assert reported["error"] == [0, [0, 0]]


def test_kinematics_limits_and_home(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
xarm = arm()
ready(xarm, 0)
home = xarm.move_gohome(speed=1.0, wait=True, timeout=20)
zero = xarm.get_position()[1]
pose = [400, 100, 250, 3.14, 0.1, 0.3]
code, angles = xarm.get_inverse_kinematics(pose)
back = xarm.get_forward_kinematics(angles)
limits = [xarm.is_joint_limit(angles), xarm.is_joint_limit([0, 0, 0, -1.0, 0, 0, 0])]
reach = [xarm.is_tcp_limit(pose), xarm.is_tcp_limit([2000, 0, 0, 3.14, 0, 0])]
far = xarm.get_inverse_kinematics([2000, 0, 0, 3.14, 0, 0])
offset = xarm.get_pose_offset([400, 0, 0, 0, 0, 0], [400, 0, 50, 0, 0, 0.5])
aa = xarm.get_position_aa()[1]
told = dict(home=home, zero=zero, code=code, pose=pose, back=back, limits=limits)
end(**told, reach=reach, far=far, offset=offset, aa=aa)
""",
    )
    assert reported["home"] == 0 and reported["zero"][:3] == pytest.approx([206.0, 0.0, 120.5], abs=0.5)
    assert reported["code"] == 0 and reported["back"][0] == 0
    assert reported["back"][1] == pytest.approx(reported["pose"], abs=0.1)
    assert reported["limits"] == [[0, False], [0, True]] and reported["reach"] == [[0, False], [0, True]]
    assert reported["far"] == [10, []]
    assert reported["offset"] == [0, [0, 0, 50, 0, 0, 0.5]]
    assert abs(abs(reported["aa"][3]) - 3.1416) < 0.01


def test_lines_relative_moves_and_circles_end_where_they_were_sent(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
xarm = arm()
ready(xarm, 0)
at, codes = [], []
def go(code):
    codes.append(code)
    at.append(xarm.get_position()[1])
turn = dict(roll=3.14159, pitch=0, yaw=0)
fast = dict(speed=300, wait=True, timeout=20)
go(xarm.set_position(x=400, y=0, z=300, **turn, **fast))
go(xarm.set_position(y=100, z=-50, relative=True, **fast))
go(xarm.set_tool_position(z=50, **fast))
go(xarm.set_position_aa([0, 0, 50, 0, 0, 0.3], relative=True, **fast))
go(xarm.move_circle([440, 140, 250, 3.14159, 0, 0], [480, 100, 250, 3.14159, 0, 0], percent=50, **fast))
go(xarm.set_servo_angle(angle=[0.1, 0, 0, 0, 0, 0, 0], relative=True, speed=1.0, wait=True))
codes.append(xarm.set_tcp_offset([0, 0, 100, 0, 0, 0]))
at.append(xarm.get_position()[1])
codes.append(xarm.set_tcp_offset([0, 0, 0, 0, 0, 0]))
until(lambda: xarm.get_state()[1] == 2)
checked = [xarm.set_position(x=x, y=0, z=300, **turn, only_check_type=1) for x in (400, 2000)]
far = xarm.set_position(x=2000, y=0, z=300, **turn, **fast)
error = xarm.get_err_warn_code()[1]
xarm.clean_error()
end(at=at, codes=codes, checked=checked, far=far, error=error)
""",
    )
    assert set(reported["codes"]) == {0}, reported
    expected = [(400, 0, 300), (400, 100, 250), (400, 100, 200), (400, 100, 250), (480, 100, 250)]
    for pose, xyz in zip(reported["at"], expected, strict=False):
        assert pose[:3] == pytest.approx(xyz, abs=1.5), reported["at"]
    x, y, z, *_ = reported["at"][5]
    assert (x, y) == pytest.approx((467.6, 147.4), abs=2.0), "joint 1 turned by 0.1 rad"
    assert reported["at"][6][:3] == pytest.approx((x, y, z - 100), abs=2.0)
    assert reported["checked"] == [0, 1] and reported["far"] == 1 and reported["error"] == [21, 0]


def test_the_online_and_velocity_modes_move_the_arm(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
xarm = arm()
ready(xarm, 0)
xarm.set_position(x=400, y=0, z=300, roll=3.14159, pitch=0, yaw=0, speed=300, wait=True)
x, y, z, *turn = xarm.get_position()[1]
ready(xarm, 5)
speed = xarm.vc_set_cartesian_velocity([0, 50, 0, 0, 0, 0], duration=1)
time.sleep(1.5)
velocity = xarm.get_position()[1][1] - y
ready(xarm, 7)
codes = [xarm.set_position(x, y + 100, z, *turn, speed=100, wait=False)]
time.sleep(0.2)
codes.append(xarm.set_position(x, y, z, *turn, speed=100, wait=False))
time.sleep(1.5)
lines = xarm.get_position()[1][1] - y
ready(xarm, 6)
q = xarm.get_servo_angle()[1]
codes.append(xarm.set_servo_angle(angle=[q[0] + 1.0, *q[1:]], speed=1.0, wait=False))
time.sleep(0.3)
codes.append(xarm.set_servo_angle(angle=q, speed=1.0, wait=False))
time.sleep(1.0)
joints = xarm.get_servo_angle()[1][0] - q[0]
ready(xarm, 2)
codes.append(xarm.get_state()[0])
end(speed=speed, velocity=velocity, lines=lines, joints=joints, codes=codes, mode=xarm.mode)
""",
    )
    assert reported["speed"] == 0 and reported["velocity"] == pytest.approx(50, abs=8)
    assert set(reported["codes"]) == {0} and reported["mode"] == 2
    assert abs(reported["lines"]) < 1.5 and abs(reported["joints"]) < 0.01


def test_an_error_is_over_after_clean_error_enable_and_state_0(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
xarm = arm()
q = servo(xarm)
kept = [*q]
past = xarm._arm.arm_cmd.move_servoj([*q[:3], -0.5, *q[4:]], 0, 0, 0)[0]
codes = [xarm.get_err_warn_code()[1][0], xarm.get_state()[1], xarm.set_servo_angle_j(q)]
xarm.set_state(0)
codes.append(xarm.get_state()[1])
xarm.clean_error()
xarm.set_state(0)
codes.append(xarm.get_state()[1])
servo(xarm)
codes.append(xarm.set_servo_angle_j(q))
xarm.set_state(4)
end(past=past, codes=codes)
""",
    )
    assert reported == {"past": 1, "codes": [23, 4, 1, 4, 4, 0]}


def test_the_reduced_mode_and_the_boundary(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
xarm = arm()
codes = [
    xarm.set_reduced_max_joint_speed(0.5),
    xarm.set_reduced_max_tcp_speed(250),
    xarm.set_reduced_joint_range([-1, 1] * 7),
    xarm.set_reduced_tcp_boundary([600, -600, 500, -500, 700, 0]),
    xarm.set_reduced_mode(True),
    xarm.set_fence_mode(True)[0],
]
states = xarm.get_reduced_states()
limits = [xarm.is_joint_limit([2, 0, 0, 0.5, 0, 0, 0]), xarm.is_tcp_limit([300, 0, -100, 3.14, 0, 0])]
codes += [xarm.set_reduced_mode(False), xarm.set_fence_mode(False)[0]]
end(codes=codes, states=states, limits=limits, off=xarm.get_reduced_mode())
""",
    )
    assert set(reported["codes"]) == {0} and reported["off"] == [0, 0]
    code, (on, sides, mm_s, rad_s, ranges, fence, rebound) = reported["states"]
    assert (code, on, sides, mm_s, rad_s) == (0, 1, [600, -600, 500, -500, 700, 0], 250, 0.5)
    assert ranges == [-1, 1] * 3 + [pytest.approx(-0.191986), 1, -1, 1, -1, 1, -1, 1] and (fence, rebound) == (1, 0)
    assert reported["limits"] == [[0, True], [0, True]]


def test_gripper_inputs_and_outputs(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
xarm = arm()
ready(xarm, 0)
codes = [
    xarm.set_gripper_mode(0),
    xarm.set_gripper_enable(True),
    xarm.set_gripper_speed(5000),
    xarm.set_gripper_position(300, wait=True),
]
opened = xarm.get_gripper_position()
past = xarm.set_gripper_position(2000, wait=True)
error = xarm.get_gripper_err_code()
xarm.clean_gripper_error()
version = xarm.get_gripper_version()
codes += [xarm.set_tgpio_digital(0, 1), xarm.set_cgpio_digital(3, 1), xarm.set_cgpio_digital(9, 1)]
codes += [xarm.set_cgpio_analog(0, 2.6), xarm.set_cgpio_digital_input_function(1, 2)]
tool = [xarm.get_tgpio_output_digital(), xarm.get_tgpio_digital(), xarm.get_tgpio_analog()]
tool.append(xarm.get_tgpio_version())
box = [xarm.get_cgpio_digital(), xarm.get_cgpio_analog()]
state = xarm.get_cgpio_state()
until(lambda: xarm.cgpio_states and xarm.cgpio_states[5] == state[1][5])
xarm.set_counter_reset()
xarm.set_counter_increase()
xarm.set_counter_increase()
until(lambda: xarm.count == 2)
end(codes=codes, opened=opened, past=past, error=error, version=version, tool=tool, box=box, state=state)
""",
    )
    assert set(reported["codes"]) == {0}, reported
    assert reported["opened"] == [0, 300]
    assert (reported["past"], reported["error"]) == (102, [0, 25]), (
        "a position that it does not have is its error 25"
    )
    assert reported["version"] == [0, "3.4.3"]
    output, digital, analog, version = reported["tool"]
    assert output == [0, [1, 0, 0, 0, 0]] and digital == [0, [0, 0, 0, 0]] and analog == [0, [0, 0]]
    assert version == [0, "2.8.12"]
    assert reported["box"] == [[0, [1] * 16], [0, [0, 0]]]
    code, state = reported["state"]
    assert code == 0 and state[5] == 1 << 3 | 1 << 9 and state[8] == pytest.approx(2.6, abs=0.01)
    assert state[10][1] == 2 and len(state[10]) == 16


def test_a_velocity_ends_with_its_duration(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
xarm = arm(report_type="real")
assert xarm.motion_enable(True) == 0 and xarm.set_mode(4) == 0 and xarm.set_state(0) == 0
until(lambda: xarm.mode == 4)
q = xarm.get_servo_angle()[1][0]
code = xarm.vc_set_joint_velocity([0.5, 0, 0, 0, 0, 0, 0], duration=0.3)
time.sleep(0.8)
end(code=code, moved=xarm.get_servo_angle()[1][0] - q)
""",
    )
    assert reported["code"] == 0
    assert 0.1 < reported["moved"] < 0.25


def test_two_arms_at_once_and_a_newer_firmware(twin: TwinProcess, tmp_path: Path) -> None:
    options = {"firmware": "2.5.0", "serial": "XF1305000001"}
    with TwinProcess(tmp_path, "xarm7", "xarm", options=options) as other:
        assert other.port != twin.port
        reported = run(
            twin,
            """
one = arm()
XCONF.SocketConf.TCP_CONTROL_PORT = int(sys.argv[4])
two = arm(sys.argv[3])
p, q = servo(one), servo(two)
for at in range(40):
    assert one.set_servo_angle_j([p[0] + 0.004 * (at + 1), *p[1:]]) == 0
    assert two.set_servo_angle_j([q[0] - 0.004 * (at + 1), *q[1:]]) == 0
    time.sleep(0.01)
until(lambda: one.get_servo_angle()[1][0] - p[0] > 0.14)
until(lambda: two.get_servo_angle()[1][0] - q[0] < -0.14)
one.emergency_stop()
two.emergency_stop()
end(versions=[one.version_number, two.version_number], states=[one.state, two.state])
""",
            *other.port.split(":"),
        )
    assert reported == {"versions": [[1, 12, 10], [2, 5, 0]], "states": [4, 4]}
