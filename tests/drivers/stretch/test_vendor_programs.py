"""Test the vendor's own test programs for a robot, unmodified, on the twin: they home it, and move each part of it.

``NOT_RUN`` names the programs that are left out, with the reason.
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from strands_actors.testing import Twin

from .vendor import environment

pytestmark = [pytest.mark.real_time, pytest.mark.long]

PATIENCE_S = 300.0
LIFT = "test_lift.TestLift", (
    "vel_guarded_contact", "valid_startup_status", "homing", "move_lift_with_soft_limits", "waypoint_trajectory",
    "reject_invalid_first_waypoint",
)  # fmt: skip
ARM = "test_arm.TestArm", (
    "vel_guarded_contact", "valid_startup_status", "homing", "move_arm_with_soft_limits", "waypoint_trajectory",
    "reject_invalid_first_waypoint",
)  # fmt: skip
BASE = "test_base.TestBase", ("valid_startup_status", "waypoint_trajectory", "multidof_waypoint_trajectory")
HEAD = "test_head.TestHead", ("homing", "joints", "get_joints", "waypoint_trajectory")
END_OF_ARM = "test_end_of_arm.TestEndOfArm", ("homing", "joints", "get_joints")
WRIST_YAW = "test_wrist_yaw.TestWristYaw", (
    "trajectory_watchdog_velocity_control", "waypoint_trajectory", "runstopped_waypoint_trajectory",
)  # fmt: skip
GRIPPER = "test_stretch_gripper.TestStretchGripper", ("waypoint_trajectory",)
PIMU = "test_pimu.TestPimu", ("invalid_protocol", "runstop_status")
SYNC = "test_sync.TestSync", (
    "runstop_sync_disabled", "runstop_sync_enabled", "sync_stream", "sync_when_disabled",
)  # fmt: skip
WAIT = "test_wait_command.TestRobotMovement", ("movement_accuracy",)
ROBOT = "test_robot.TestRobot", ("waypoint_trajectory_multidof_base", "reject_invalid_first_waypoint")
PROGRAMS = [
    f"{suite}.test_{name}"
    for suite, names in (LIFT, ARM, BASE, HEAD, END_OF_ARM, WRIST_YAW, GRIPPER, PIMU, SYNC, WAIT, ROBOT)
    for name in names
]
NOT_RUN = {
    "test_base.TestBase.test_fast_base_motion_allowed": (
        "it needs a lift below 0.3 m after stow(), which moves the lift to 0.3 m with this tool"
    ),
    "test_pimu.TestPimu.test_motor_sync_rate": "it reads a counter that the client has only for old firmware",
    **dict.fromkeys(
        (
            "test_robot.TestRobot.test_home_and_stow",
            "test_robot.TestRobot.test_endofarmtool_loaded",
            "test_robot.TestRobot.test_endofarmtool_custom_stowing",
            "test_robot.TestRobot.test_soft_limits_not_overwritten",
            "test_robot.TestRobot.test_dynamixel_runstop",
            "test_robot.TestRobot.test_waypoint_trajectory",
        ),
        "the vendor skips it",
    ),
}
WITHOUT_ROBOT = frozenset(
    (
        "test_collisions", "test_device", "test_dynamixel_XL430", "test_dynamixel_hello_XL430", "test_dxl_comms",
        "test_dxl_sine_vel", "test_dxl_vel", "test_end_of_arm_tools", "test_hello_utils", "test_robot_params",
        "test_steppers", "test_timing_stats", "test_trajectories",
    )
)  # fmt: skip
"""Files whose tests need no robot or a further package, open a device by their own path, or were not tried."""


@pytest.fixture(scope="module")
def python() -> Path:
    return environment()


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_of_the_vendor_runs_to_its_end(program: str, tmp_path: Path, python: Path) -> None:
    with Twin("stretch3", tmp_path) as twin:
        fleet = Path(twin.port).parent / "fleet"
        (robot,) = fleet.iterdir()
        done = subprocess.run(
            [str(python), str(Path(__file__).parent / "vendor_program.py"), str(fleet), robot.name, program],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
            env={**os.environ, "HOME": str(tmp_path)},
        )
    assert done.returncode == 0, done.stderr[-3000:]


def test_each_program_is_run_or_has_a_reason(python: Path) -> None:
    (folder,) = python.parents[1].glob("lib/python*/site-packages/test")
    found = set()
    for path in folder.glob("test_*.py"):
        if path.stem not in WITHOUT_ROBOT:
            text = path.read_text("utf-8")
            (suite,) = re.findall(r"^class (\w+)\(", text, re.MULTILINE)
            found |= {
                f"{path.stem}.{suite}.{name}" for name in re.findall(r"^    def (test_\w+)", text, re.MULTILINE)
            }
    assert found == {*PROGRAMS, *NOT_RUN}
