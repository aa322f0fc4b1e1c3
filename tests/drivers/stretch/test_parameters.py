"""Test the robot's own YAML: overridden parameters and refused values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
import trio

from strands_actors import Robot
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.stretch.driver import Stretch
from strands_actors.drivers.stretch.parameters import (
    FILES,
    Parameters,
    folder_of,
    parameters_of,
    read_folder,
)

MODEL = {"robot": {"model_name": "SE3", "tool": "eoa_wrist_dw3_tool_sg3"}}


def folder(at: Path, configuration: Any, user: Any = None) -> Path:
    (at / "stretch-se3-1234").mkdir()
    for name, words in zip(FILES, (configuration, user), strict=True):
        (at / "stretch-se3-1234" / name).write_text("" if words is None else json.dumps(words))
    return at / "stretch-se3-1234"


def test_parameters_of_a_model_are_overridden_by_calibration_and_user(tmp_path: Path) -> None:
    calibrated = {**MODEL, "lift": {"range_m": [0.0, 1.09], "i_feedforward": 1.1}, "wrist_yaw": {"zero_t": 7000}}
    found = read_folder("stretch3", folder(tmp_path, calibrated, {"lift": {"range_m": [0.1, 0.9]}}))
    common = parameters_of("stretch3")
    assert (found.lift.low_m, found.lift.high_m, found.lift.feedforward_a) == (0.1, 0.9, 1.1)
    assert found.wrist.joints[0].zero == 7000.0
    assert found.arm == common.arm and found.head == common.head


def test_units_of_the_two_joints_that_are_metres() -> None:
    found = parameters_of("stretch3")
    # a pinion of 12 teeth on a belt of 5 mm; ten teeth of a chain of 16.7 mm behind a gear of 3.875
    assert found.lift.rad_per_m == pytest.approx(2 * 3.14159265 / 0.06)
    assert found.arm.rad_per_m == pytest.approx(2 * 3.14159265 * 3.875 / 0.167)
    assert found.left.rad_per_m == pytest.approx(3.8 / 0.0508)


@pytest.mark.parametrize(
    ("robot", "said", "why"),
    [
        ("stretch3", {"robot": {"model_name": "RE2V0"}}, "its YAML is of a RE2V0, but stretch3 is a SE3"),
        ("stretch", {"robot": {"model_name": "RE1V0"}}, "its YAML is of a RE1V0, but stretch is a RE2V0"),
        ("stretch3", {"robot": {"model_name": "SE3", "tool": "hammer"}}, "its YAML names the tool 'hammer'"),
        ("stretch3", {**MODEL, "lift": {"range_m": None}}, "a value has a wrong type or range"),
        ("stretch3", {**MODEL, "lift": {"range_m": [0.0]}}, "not enough values"),
        ("stretch3", {**MODEL, "base": {"wheel_diameter_m": 0.0}}, "a value has a wrong type or range"),
        ("stretch3", {**MODEL, "lift": {"motion": {"default": {"vel_m": float("inf")}}}}, "not finite"),
    ],
)
def test_parameters_of_another_robot_are_refused(
    robot: str, said: dict[str, Any], why: str, tmp_path: Path
) -> None:
    with pytest.raises(WireDown, match=why):
        read_folder(robot, folder(tmp_path, said))


def test_the_wrist_has_the_joints_of_its_tool_and_the_gripper_is_not_driven(tmp_path: Path) -> None:
    straight = parameters_of("stretch2", {"robot": {"model_name": "RE2V0", "tool": "tool_stretch_gripper"}})
    driver = Stretch("stretch2", "", {"parameters": msgspec.to_builtins(straight)})
    assert driver.axes == ("lift", "arm", "wrist_yaw", "head_pan", "head_tilt", "vx", "wz")
    assert straight.wrist.others == (14,)
    assert parameters_of("stretch3").wrist.others == (14,)
    pro = {"robot": {"model_name": "SE3", "tool": "eoa_wrist_dw3_tool_sg3_pro"}}
    assert parameters_of("stretch3", pro).wrist.others == (17,)


def test_a_file_that_is_no_yaml_or_not_there_is_named(tmp_path: Path) -> None:
    at = folder(tmp_path, MODEL)
    (at / FILES[1]).write_text("lift: [")
    with pytest.raises(WireDown, match=r"stretch_user_params\.yaml cannot be read"):
        read_folder("stretch3", at)
    (at / FILES[1]).write_text("just text")
    with pytest.raises(WireDown, match="contains no YAML mapping"):
        read_folder("stretch3", at)
    (at / FILES[0]).unlink()
    with pytest.raises(WireDown, match=r"stretch_configuration_params\.yaml cannot be read"):
        read_folder("stretch3", at)


def test_without_a_robot_the_missing_environment_is_named(monkeypatch: pytest.MonkeyPatch, run_dir: Path) -> None:
    monkeypatch.delenv("HELLO_FLEET_PATH", raising=False)
    with pytest.raises(WireDown, match="HELLO_FLEET_PATH and HELLO_FLEET_ID are not set"):
        folder_of({"HELLO_FLEET_ID": "stretch-se3-1234"})
    robot = Robot("stretch3", mode="real")
    assert "HELLO_FLEET_PATH and HELLO_FLEET_ID are not set" in str(robot.connect_eagerly())
    robot.cleanup()


@pytest.mark.parametrize("port", ["/dev/ttyACM0", "/dev/hello-motor-lift", "192.0.2.1"])
def test_a_port_is_refused(port: str) -> None:
    with pytest.raises(ValueError, match=r"stretch3: port is .* Leave it out: the boards are found by their names"):
        Robot("stretch3", mode="real", port=port)


@pytest.mark.parametrize("hz", [0.0, 4.9, 51.0, float("nan"), "fast"])
def test_a_control_frequency_that_no_stretch_has_is_refused(hz: Any) -> None:
    with pytest.raises(ValueError, match="control_frequency"):
        Robot("stretch3", mode="real", control_frequency=hz)
    assert Stretch("stretch3", "", {}).timing.control_hz == 15.0


def test_parameters_are_completed_once_from_the_robots_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = folder(tmp_path, {**MODEL, "lift": {"range_m": [0.0, 1.05]}})
    monkeypatch.setenv("HELLO_FLEET_PATH", str(tmp_path))
    monkeypatch.setenv("HELLO_FLEET_ID", at.name)
    options = Stretch.resolve("stretch3", {"tool_name": "stretch3"})

    async def complete() -> dict[str, Any]:
        first = await Stretch.complete("stretch3", "", options)
        monkeypatch.delenv("HELLO_FLEET_PATH")
        assert await Stretch.complete("stretch3", "", first) == first
        return first

    completed = json.loads(json.dumps(trio.run(complete)))
    driver = Stretch("stretch3", "", completed)
    assert driver.table[0].high == 1.05
    assert msgspec.convert(completed["parameters"], Parameters) == driver.config.parameters
