"""LeRobot uses our robots: their features before connecting, their methods afterwards, and the frames on the
wire."""

from __future__ import annotations

import json
import math
import os
import re
import time
import zipfile
from pathlib import Path
from typing import Any

import pytest

from strands_actors import MeshConfig, Robot, list_native_drivers
from strands_actors.drivers.spot.robots import LEGS, TABLES
from strands_actors.testing import Twin
from tests.answers import alive, json_of, until
from tests.house.test_packaging import build

from .conftest import PLUGIN, Make

SO101 = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]
POSITIONS = [f"{axis}.pos" for axis in SO101]


@pytest.fixture
def twin(tmp_path: Path) -> Any:
    with Twin("so101", tmp_path) as twin:
        yield twin


# -- before it is connected


def test_one_module_has_all_that_is_used_of_lerobot() -> None:
    users = {
        path.stem
        for path in (PLUGIN / PLUGIN.name).glob("*.py")
        for line in path.read_text().splitlines()
        if re.match(r"\s*(from|import) lerobot\b", line)
    }
    assert users == {"lerobot_api"}


def test_lerobot_finds_it_by_the_name_of_its_distribution_and_each_class_by_its_config(
    plugin: Any, tmp_path: Path
) -> None:
    with zipfile.ZipFile(build("wheel", PLUGIN, tmp_path)) as wheel:
        (metadata,) = (name for name in wheel.namelist() if name.endswith("/METADATA"))
        lines = wheel.read(metadata).decode().splitlines()
    assert f"Name: {plugin.__name__}" in lines  # LeRobot does not find a name with hyphens
    for name, one in plugin.robots_of_lerobot.items():
        assert one.__module__ == plugin.__name__ and getattr(plugin, name) is one
        assert name.endswith("Config") or plugin.robots_of_lerobot[f"{name}Config"] is one.config_class


def test_every_arm_and_base_is_there_and_nothing_that_walks_or_flies_alone(plugin: Any) -> None:
    robots = set(plugin.robots())
    assert {"so101", "koch", "ur5e", "panda", "stretch3", "earthrover", "robotiq_2f85", "spot"} <= robots
    assert set(list_native_drivers()) - robots >= {"crazyflie", "unitree_g1", "unitree_go2"}
    assert {f"strands_{robot}" for robot in robots} | {"strands_remote"} == {
        one.name for name, one in plugin.robots_of_lerobot.items() if not name.endswith("Config")
    }


def test_features_are_known_before_anything_is_connected(make: Make, plugin: Any) -> None:
    camera = __import__("lerobot.cameras", fromlist=["CameraConfig"]).CameraConfig
    arm = make("strands_so101", port="/dev/null", cameras={"wrist": camera(width=640, height=480, fps=30)})
    assert arm.action_features == dict.fromkeys(POSITIONS, float)
    assert arm.observation_features == {**arm.action_features, "wrist": (480, 640, 3)}
    assert not arm.is_connected and arm.is_calibrated
    assert list(make("strands_stretch3", twin=True).action_features)[-2:] == ["vx.vel", "wz.vel"]
    for robot in plugin.robots():
        assert make(f"strands_{robot}", twin=True).action_features


@pytest.mark.parametrize(
    ("keywords", "text"),
    [
        ({}, "so101 needs 'port'"),
        ({"port": "/dev/null", "twin": True}, "both given"),
        ({"twin": True, "use_degrees": False}, "use_degrees=false needs a calibration"),
        ({"twin": True, "refusals": 0}, "refusals is 0. Give the number of refused actions"),
        ({"twin": True, "name": "my arm"}, "tool_name is 'my arm'"),
        ({"twin": True, "mesh": "/no/such.toml"}, "/no/such.toml cannot be read"),
    ],
)
def test_saf_014_invalid_options_are_refused_at_construction(
    make: Make, keywords: dict[str, Any], text: str
) -> None:
    with pytest.raises(ValueError, match=text):
        make("strands_so101", **keywords)


def test_a_calibration_of_lerobots_is_used_by_id_and_normalised_numbers_are_of_its_range(
    make: Make, tmp_path: Path
) -> None:
    motors = {
        axis: {"id": at, "drive_mode": 0, "homing_offset": 0, "range_min": 1024, "range_max": 3072}
        for at, axis in enumerate(SO101, start=1)
    }
    (tmp_path / "black.json").write_text(json.dumps(motors))
    options = {"port": "/dev/null", "id": "black", "calibration_dir": tmp_path}
    arm = make("strands_so101", **options, use_degrees=False)
    pan, *_, gripper = arm._features
    low, high = arm._handle().driver.travel()["shoulder_pan"]
    assert pan.to_lerobot(low) == pytest.approx(-100.0) and pan.to_lerobot(high) == pytest.approx(100.0)
    assert pan.from_lerobot(pan.to_lerobot(12.5)) == pytest.approx(12.5)
    assert gripper.to_lerobot(33.0) == 33.0
    assert make("strands_so101", **options)._features[0].to_lerobot(12.5) == 12.5


def test_angles_are_degrees_for_lerobot_for_any_unit_of_the_robot(make: Make) -> None:
    first, *_ = make("strands_ur5e", twin=True)._features
    assert (first.key, first.to_lerobot(math.pi)) == ("shoulder_pan_joint.pos", pytest.approx(180.0))
    assert first.from_lerobot(-90.0) == pytest.approx(-math.pi / 2)


def test_a_call_of_an_unconnected_robot_raises(make: Make) -> None:
    arm = make("strands_so101", twin=True)
    for call in (arm.get_observation, arm.disconnect, lambda: arm.send_action({})):
        with pytest.raises(ConnectionError, match="not connected"):
            call()


# -- connected


def test_saf_014_a_loop_moves_the_twin_and_a_refused_action_is_never_on_the_wire(twin: Twin, make: Make) -> None:
    arm = make("strands_so101", port=twin.port, refusals=3)
    arm.connect()
    with pytest.raises(ConnectionError, match="already connected"):
        arm.connect()
    seen = arm.get_observation()
    assert list(seen) == POSITIONS and all(type(value) is float for value in seen.values())
    goal = {**seen, "shoulder_pan.pos": seen["shoulder_pan.pos"] + 5.0}
    accepted = arm.send_action(goal)
    assert accepted == pytest.approx(goal)
    until(lambda: abs(arm.get_observation()["shoulder_pan.pos"] - goal["shoulder_pan.pos"]) < 1.0, "it moves")
    until(lambda: twin.log.host("setpoint"), "the log has it")
    begun_ns = time.monotonic_ns()
    past = {**goal, "shoulder_pan.pos": 400.0}
    for _ in range(2):
        assert arm.send_action(past) == accepted  # the last accepted action
    assert arm.send_action(goal) == pytest.approx(goal)  # only refusals in a row are counted
    for _ in range(2):
        arm.send_action({"elbow.pos": 1.0})
    with pytest.raises(ConnectionError, match=r"3 actions in a row were refused, the last: .*400.* is past"):
        arm.send_action(past)
    arm.disconnect()
    twin.log.no_setpoint_after_safe(begun_ns)
    same = {frame.data for frame in twin.log.host("setpoint") if frame.t_ns < begun_ns}
    assert {frame.data for frame in twin.log.host("setpoint", begun_ns)} <= same  # the same goal, repeated


def test_joints_that_are_only_read_are_observed_in_degrees_and_are_no_action(make: Make, tmp_path: Path) -> None:
    with Twin("spot", tmp_path, options={"arm": True}) as twin:
        spot = make("strands_spot", port=twin.port)
        assert list(spot.observation_features) == [*spot.action_features, *(f"{leg}.pos" for leg in LEGS)]
        spot.connect()
        seen = spot.get_observation()
        assert list(seen) == list(spot.observation_features)
        knee_rad = TABLES.table("spot")["sit_leg_rad"][2]
        assert seen["hr_kn.pos"] == pytest.approx(math.degrees(knee_rad), abs=0.1), "it sits"
        spot.disconnect()


@pytest.mark.long
def test_saf_005_disconnecting_stops_reads_back_and_ends_the_tree_and_it_may_connect_again(
    twin: Twin, make: Make
) -> None:
    arm = make("strands_so101", port=twin.port, name="left")
    for _ in range(2):
        arm.connect()
        processes = [one["pid"] for one in arm._arm.tree()["processes"] if one["role"] in ("root", "wire")]
        begun_ns = time.monotonic_ns()
        arm.disconnect()
        assert not arm.is_connected
        twin.log.no_setpoint_after_safe(begun_ns)
        until(lambda pids=processes: not any(map(alive, pids)), "its processes end")  # type: ignore[misc]
    arm.connect()
    twin.fault("stuck:3")
    twin.fault("off:4")
    with pytest.raises(ConnectionError, match=r"not confirmed by .*wrist_flex \(id 4\)"):
        arm.disconnect()
    twin.fault("ok")


def test_saf_012_an_old_reading_does_not_count(twin: Twin, make: Make) -> None:
    arm = make("strands_so101", port=twin.port)
    arm.connect()
    arm.get_observation()
    twin.pause()
    try:

        def told() -> str:
            try:
                arm.get_observation()
            except ConnectionError as error:
                return str(error)
            return ""

        assert until(told, "it is told")
    finally:
        twin.go_on()


def test_a_failed_connection_gives_its_reason_and_leaves_no_process(twin: Twin, make: Make) -> None:
    camera = __import__("lerobot.cameras", fromlist=["CameraConfig"]).CameraConfig
    there = camera(width=4, height=3, fps=30)
    arm = make("strands_so101", port="/dev/no-such-port", cameras={"wrist": there})
    with pytest.raises(ConnectionError, match="/dev/no-such-port"):
        arm.connect()
    assert not arm.is_connected and not arm.cameras["wrist"].is_connected
    broken = camera(width=4, height=3, fps=30, broken=True)
    arm = make("strands_so101", port=twin.port, cameras={"wrist": there, "front": broken})
    with pytest.raises(ConnectionError, match="no such camera"):
        arm.connect()
    assert not arm.is_connected and not arm.cameras["wrist"].is_connected
    assert twin.log.host("enable") == []  # cameras are checked first, so no motor was energised
    arm = make("strands_so101", port=twin.port, cameras={"wrist": there})
    arm.connect()
    assert arm.get_observation()["wrist"] == "a picture"


def test_a_robot_of_another_host_is_stopped_and_goes_on_there(twin: Twin, make: Make, tmp_path: Path) -> None:
    from tests.ports import free_port

    at = f"tcp/127.0.0.1:{free_port()}"
    here = Robot("so101", mode="real", port=twin.port, mesh=MeshConfig(listen=at, insecure=True), tool_name="lent")
    elsewhere, home = tmp_path / "e", os.environ["STRANDS_ACTORS_RUN"]
    elsewhere.mkdir(mode=0o700)
    try:
        assert here.connect_eagerly() is None
        json_of(here.release())
        os.environ["STRANDS_ACTORS_RUN"] = str(elsewhere)  # the fixture of every test restores it
        (tmp_path / "mesh.toml").write_text("insecure = true\n")
        there = make("strands_remote", robot="so101", at=at, name="lent", mesh=str(tmp_path / "mesh.toml"))
        assert list(there.action_features) == POSITIONS
        there.connect()
        seen = there.get_observation()
        assert there.send_action({**seen, "wrist_roll.pos": 5.0})["wrist_roll.pos"] == pytest.approx(5.0)
        begun_ns = time.monotonic_ns()
        there.disconnect()
        twin.log.no_setpoint_after_safe(begun_ns)
        until(lambda: here.is_connected, "its own host has it still")
    finally:
        os.environ["STRANDS_ACTORS_RUN"] = home
        here.cleanup()
