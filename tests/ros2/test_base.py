"""A mobile base on the graph: odometry, IMU, and a twist that moves it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.surfaces.ros2.bridge import Options
from strands_actors.testing import Twin
from tests.answers import until
from tests.ports import free_port

from .conftest import World
from .peer import STORE, Program, router
from .test_motion import Stream
from .world import RunningBridge

CMD_VEL = "/yahboom_m3pro/cmd_vel"


@pytest.fixture
def base(tmp_path: Path, run_dir: Path, patient: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[World]:
    # The driver guards its twist: over the mesh it needs the permission of the robot's host.
    monkeypatch.setenv("STRANDS_ACTORS_ALLOW", "linear.x,linear.y,angular.z")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    options = Options(router=endpoint, allow_motion=True)
    with Twin("yahboom_m3pro", tmp_path) as twin, router(endpoint), RunningBridge(options) as bridge:
        robot = Robot("yahboom_m3pro", mode="real", port=twin.port)
        try:
            assert robot.connect_eagerly() is None
            assert robot.release()["status"] == "success"
            with Program(endpoint) as program:
                until(lambda: CMD_VEL in program.names("MS"), f"the node appears: {bridge.lines}")
                yield World(robot, twin, program, bridge, endpoint)
        finally:
            robot.cleanup()


def twist(x: float) -> Any:
    vector = STORE.types["geometry_msgs/msg/Vector3"]
    return STORE.types["geometry_msgs/msg/Twist"](vector(x, 0.0, 0.0), vector(0.0, 0.0, 0.0))


def stamped(message: Any) -> Any:
    stamp = STORE.types["builtin_interfaces/msg/Time"](0, 0)
    header = STORE.types["std_msgs/msg/Header"](stamp, "")
    return STORE.types["geometry_msgs/msg/TwistStamped"](header, message)


@pytest.mark.long
def test_a_twist_moves_the_base_and_zeros_give_the_lease_back(base: World) -> None:
    odometry = base.program.listen("/yahboom_m3pro/odom", "nav_msgs/msg/Odometry")
    transforms = base.program.listen("/tf", "tf2_msgs/msg/TFMessage")
    inertial = base.program.listen("/yahboom_m3pro/imu", "sensor_msgs/msg/Imu")
    x = until(lambda: odometry, "odometry")[-1].pose.pose.position.x
    with Stream(base.program, CMD_VEL, lambda: stamped(twist(0.2))):
        until(lambda: odometry[-1].pose.pose.position.x > x + 0.05, f"it drives: {base.bridge.lines}")
        assert odometry[-1].twist.twist.linear.x > 0.0
    with Stream(base.program, CMD_VEL, lambda: twist(0.0)):
        until(lambda: base.arm.get_observation()["linear.x"] == 0.0, "it stands")
    # The lease was given back, so another program may drive without a resume.
    until(lambda: base.arm.send_action({"linear.x": 0.0})["status"] == "success", "the robot's own program drives")
    assert base.arm.release()["status"] == "success"
    message = odometry[-1]
    assert (message.header.frame_id, message.child_frame_id) == ("yahboom_m3pro/odom", "yahboom_m3pro/base")
    assert until(lambda: transforms, "tf")[-1].transforms[0].child_frame_id == "yahboom_m3pro/base"
    assert until(lambda: inertial, "the IMU")[-1].header.frame_id == "yahboom_m3pro/imu"
