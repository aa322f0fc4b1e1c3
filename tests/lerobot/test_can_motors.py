"""LeRobot's buses of Damiao and RobStride motors, and its arms of such motors, on our twins."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from can.interfaces.slcan import slcanBus
from lerobot.motors import Motor, MotorNormMode
from lerobot.motors.damiao import DamiaoMotorsBus
from lerobot.motors.robstride import RobstrideMotorsBus
from lerobot.robots.openarm_follower import OpenArmFollower, OpenArmFollowerConfig
from lerobot.robots.rebot_b601_follower import RebotB601Follower, RebotB601FollowerRobotConfig

from strands_actors import Robot
from strands_actors.testing import Twin
from tests.answers import until

TABLE = """
joints = [
  { key = "joint1", motor = "rs02", id = 1, low = -2, high = 2, speed = 2, torque = 10, kp = 30, kd = 1 },
  { key = "joint2", motor = "rs02", id = 2, low = -2, high = 2, speed = 2, torque = 10, kp = 30, kd = 1 },
]
"""
"""An arm of two RobStride motors."""


@pytest.fixture(autouse=True)
def slcan_is_there_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slcanBus, "_SLEEP_AFTER_SERIAL_OPEN", 0)


def motors(kind: str, recv: int, count: int, names: str) -> dict[str, Motor]:
    made = {}
    for number in range(1, count + 1):
        motor = Motor(number, kind, MotorNormMode.DEGREES)
        motor.recv_id = number + recv
        motor.motor_type_str = kind
        made[f"{names}{number}"] = motor
    return made


def test_the_bus_of_damiao_motors(tmp_path: Path) -> None:
    with Twin("yam", tmp_path) as twin:
        bus = DamiaoMotorsBus(twin.port, motors("dm4340", 16, 3, "joint"), can_interface="slcan", use_can_fd=False)
        bus.connect()
        for name in ("joint1", "joint2", "joint3"):
            bus.write("Kp", name, 80.0)
            bus.write("Kd", name, 3.0)

        def arrived() -> bool:
            bus.sync_write("Goal_Position", {"joint1": 20.0, "joint2": 10.0, "joint3": 15.0})
            return abs(float(bus.sync_read("Present_Position")["joint1"]) - 20.0) < 3.0

        until(arrived, "the first joint is at its goal")
        bus.disconnect()
        until(lambda: bool(twin.log.host("safe")), "torque is off")


def test_the_bus_of_robstride_motors_in_their_mit_protocol(tmp_path: Path) -> None:
    table = tmp_path / "mine.toml"
    table.write_text(TABLE)
    with Twin("mine", tmp_path, options={"table": table, "mit_protocol": True}) as twin:
        bus = RobstrideMotorsBus(twin.port, motors("O2", 0, 2, "joint"), can_interface="slcan", use_can_fd=False)
        bus.connect()
        bus.configure_motors()

        def arrived() -> bool:
            bus.sync_write("Goal_Position", {"joint1": 20.0, "joint2": -10.0})
            return abs(float(bus.sync_read("Present_Position")["joint1"]) - 20.0) < 3.0

        until(arrived, "the first joint is at its goal")
        bus.disconnect()


def test_openarm_follower_moves_the_twin_of_an_openarm(tmp_path: Path) -> None:
    with Twin("openarm", tmp_path) as twin:
        config = OpenArmFollowerConfig(port=twin.port, side="right", can_interface="slcan", use_can_fd=False)
        arm: Any = OpenArmFollower(config)
        arm.bus.connect()

        def arrived() -> bool:
            arm.send_action({"joint_4.pos": 20.0})
            return abs(float(arm.bus.sync_read("Present_Position")["joint_4"]) - 20.0) < 3.0

        until(arrived, "the elbow is at its goal")
        arm.bus.disconnect()


def test_rebot_follower_moves_the_twin_of_a_rebot(tmp_path: Path) -> None:
    with Twin("rebot_b601", tmp_path) as twin:
        arm: Any = RebotB601Follower(RebotB601FollowerRobotConfig(port=twin.port, gripper_control_mode="mit"))
        arm.connect(calibrate=False)

        def arrived() -> bool:
            arm.send_action({"shoulder_pan.pos": 20.0, "wrist_yaw.pos": 0.0})
            return abs(float(arm.get_observation()["shoulder_pan.pos"]) - 20.0) < 3.0

        until(arrived, "the shoulder is at its goal")
        arm.disconnect()


def test_lerobots_class_runs_as_a_driver(tmp_path: Path) -> None:
    keys = (*(f"joint_{number}" for number in range(1, 8)), "gripper")
    row = {"drive_mode": 0, "homing_offset": 0, "range_min": -90, "range_max": 90}
    motors = {key: {"id": number, **row} for number, key in enumerate(keys, 1)}
    (tmp_path / "openarm.json").write_text(json.dumps(motors))
    with (
        Twin("openarm", tmp_path) as twin,
        Robot(
            "openarm",
            mode="real",
            driver="lerobot",
            port=twin.port,
            side="right",
            can_interface="slcan",
            use_can_fd=False,
            calibration_dir=str(tmp_path),
        ) as arm,
    ):
        assert arm.connect_eagerly() is None
        assert all(map(math.isfinite, arm.get_observation().values()))
