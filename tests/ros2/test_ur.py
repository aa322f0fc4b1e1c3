"""What only some robots report: the pose of the tool, its wrench, and pictures. Keys without hashes, too."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.kernel.channels.ros2 import cdr
from strands_actors.kernel.channels.ros2.definitions import FOLLOW, JOINT_STATE
from strands_actors.kernel.channels.ros2.names import Dialect
from strands_actors.surfaces.ros2.bridge import Options
from strands_actors.testing import Twin
from strands_actors.testing.still_camera import HEIGHT, SETTINGS, WIDTH
from tests.answers import json_of, until
from tests.ports import free_port

from .peer import Program, router
from .test_action import goal_of
from .world import RunningBridge


@contextlib.contextmanager
def ur_on_graph(directory: Path, hashed: bool, **keywords: Any) -> Iterator[tuple[Any, Program]]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    options = Options(router=endpoint, dialect=Dialect(hashed=hashed), allow_motion=True)
    with Twin("ur5e", directory) as twin, router(endpoint), RunningBridge(options) as bridge:
        arm = Robot("ur5e", mode="real", port=twin.port, **keywords)
        try:
            assert arm.connect_eagerly() is None
            assert arm.release()["status"] == "success"
            with Program(endpoint) as program:
                until(
                    lambda: "/ur5e/joint_command" in program.names("MS"),
                    str(bridge.lines),
                )
                yield arm, program
        finally:
            arm.cleanup()


def test_pose_wrench_and_pictures_of_an_arm(tmp_path: Path, run_dir: Path, patient: None) -> None:
    with ur_on_graph(tmp_path, True, cameras={"eye": SETTINGS}) as (arm, program):
        wrenches = program.listen("/ur5e/wrench", "geometry_msgs/msg/WrenchStamped")
        poses = program.listen("/ur5e/tool_pose", "geometry_msgs/msg/PoseStamped")
        image = "/ur5e/eye/image_raw/compressed"
        until(lambda: image in program.names("MP"), "the camera appears")
        pictures = program.listen(image, "sensor_msgs/msg/CompressedImage")
        infos = program.listen("/ur5e/eye/camera_info", "sensor_msgs/msg/CameraInfo")
        pose = until(lambda: poses, "poses")[-1]
        expected = json_of(arm.get_pose())
        position = pose.pose.position
        assert [position.x, position.y, position.z] == pytest.approx(expected["xyz"], abs=1e-3)
        turn = pose.pose.orientation
        same = abs(sum(a * b for a, b in zip((turn.w, turn.x, turn.y, turn.z), expected["quat"], strict=True)))
        assert same == pytest.approx(1.0, abs=1e-4) and pose.header.frame_id == "ur5e/base"
        assert until(lambda: wrenches, "wrenches")[-1].header.frame_id == "ur5e/base"
        picture = until(lambda: pictures, "pictures")[-1]
        assert bytes(picture.data[:2]) == b"\xff\xd8" and picture.format == "jpeg"
        info = until(lambda: infos, "camera info")[-1]
        assert (info.width, info.height, info.header.frame_id) == (WIDTH, HEIGHT, "ur5e/eye_optical")


def test_humble_reads_and_moves_an_arm_with_keys_without_hashes(
    tmp_path: Path, run_dir: Path, patient: None
) -> None:
    with ur_on_graph(tmp_path, False) as (_, program):
        assert {parts[11] for parts in program.tokens() if parts[5] != "NN"} == {"TypeHashNotSupported"}
        received = program.listen_raw(
            "0/ur5e/joint_states/sensor_msgs::msg::dds_::JointState_/TypeHashNotSupported"
        )
        message = cdr.decode(JOINT_STATE, until(lambda: received, "joint states")[-1])
        joint, start = message["name"][0], message["position"][0]
        follow = "0/ur5e/follow_joint_trajectory/_action"
        types = "control_msgs::action::dds_::FollowJointTrajectory"
        goal_id = {"goal_id": {"uuid": b"\1" * 16}}
        goal = {**goal_id, "goal": goal_of({1.0: [start + 0.2]}, (joint,))}
        key = f"{follow}/send_goal/{types}_SendGoal_/TypeHashNotSupported"
        assert program.call(key, cdr.encode(f"{FOLLOW}_SendGoal_Request", goal))[4] == 1
        key = f"{follow}/get_result/{types}_GetResult_/TypeHashNotSupported"
        answer = program.call(key, cdr.encode(f"{FOLLOW}_GetResult_Request", goal_id))
        assert cdr.decode(f"{FOLLOW}_GetResult_Response", answer)["status"] == 4
        key = "0/ur5e/stop/std_srvs::srv::dds_::Trigger_/TypeHashNotSupported"
        assert program.call(key, b"\0\1\0\0\0")[4] == 1
