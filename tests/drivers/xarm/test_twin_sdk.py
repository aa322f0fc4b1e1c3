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

def servo(arm):
    assert arm.motion_enable(True) == 0 and arm.set_mode(1) == 0 and arm.set_state(0) == 0
    until(lambda: arm.mode == 1 and arm.state == 2)
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
    ik=xarm.get_inverse_kinematics([300, 0, 300, 3.14, 0, 0])[0],
    fk=xarm.get_forward_kinematics(q)[0],
    tgpio=xarm.get_tgpio_digital()[0],
    cgpio=xarm.get_cgpio_analog()[0],
    line=xarm.set_position(x=300, y=0, z=300, roll=3.14, pitch=0, yaw=0, wait=False),
    record=xarm.start_record_trajectory(),
    wrong_mode=xarm._arm.arm_cmd.move_joint(q, 0.5, 10, 0)[0],
)
xarm.set_mode(0)
xarm.set_state(0)
until(lambda: xarm.mode == 0 and xarm.state == 2)
limits = [xarm.is_joint_limit(q), xarm.is_joint_limit([*q[:3], -1.0, *q[4:]])]
home = xarm.move_gohome(speed=1.0, wait=True, timeout=20)
xarm.set_state(4)
end(codes=codes, limits=limits, home=home, at=xarm.get_servo_angle()[1])
""",
    )
    assert set(reported["codes"].values()) == {10}, reported
    assert reported["limits"] == [[0, False], [0, True]]
    assert reported["home"] == 0 and max(map(abs, reported["at"])) < 0.01


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
