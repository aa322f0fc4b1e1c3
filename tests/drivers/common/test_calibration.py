"""Test lerobot calibration files: where they are found, and which content is refused."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from strands_actors.drivers.common.kit import calibration
from strands_actors.drivers.feetech.driver import Feetech

MOTORS = {
    "shoulder_pan": 1,
    "shoulder_lift": 2,
    "elbow_flex": 3,
    "wrist_flex": 4,
    "wrist_roll": 5,
    "gripper": 6,
}


def content() -> dict[str, Any]:
    return {
        name: {
            "id": motor,
            "drive_mode": 0,
            "homing_offset": -100 * motor,
            "range_min": 700,
            "range_max": 3300,
        }
        for name, motor in MOTORS.items()
    }


def write(path: Path, data: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(data if isinstance(data, str) else json.dumps(data))
    return path


def test_a_file_is_loaded(tmp_path: Path) -> None:
    path = write(tmp_path / "arm.json", content())
    loaded = calibration.load(path, MOTORS, 2047)
    assert loaded["gripper"] == calibration.MotorCalibration(6, 0, -600, 700, 3300)
    assert list(loaded) == list(MOTORS)


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("id", 254, "id is 254, must be 0..253"),
        ("id", -1, "id is -1, must be 0..253"),
        ("id", 7, "has id 7 for elbow_flex, this robot has id 3"),
        ("id", True, "id is True, must be an integer"),
        ("drive_mode", 2, "drive_mode is 2, must be 0..1"),
        ("homing_offset", 2048, "homing_offset is 2048, must be -2047..2047"),
        ("homing_offset", 1.5, "homing_offset is 1.5, must be an integer"),
        ("range_min", -1, "range_min is -1, must be 0..4095"),
        ("range_min", 3300, "range_min 3300 must be below range_max 3300"),
        ("range_max", 4096, "range_max is 4096, must be 0..4095"),
        ("range_max", "3000", "range_max is '3000', must be an integer"),
        ("range_max", None, "range_max is None, must be an integer"),
        ("offset", 1, "unknown field offset. It must have exactly id, drive_mode"),
    ],
)
def test_every_field_is_checked(tmp_path: Path, field: str, value: object, says: str) -> None:
    data = content()
    data["elbow_flex"][field] = value
    path = write(tmp_path / "arm.json", data)
    with pytest.raises(ValueError) as refused:
        calibration.load(path, MOTORS, 2047)
    text = str(refused.value)
    assert says in text
    assert str(path) in text
    assert "elbow_flex" in text


def test_a_missing_field_is_named(tmp_path: Path) -> None:
    data = content()
    del data["elbow_flex"]["range_max"]
    with pytest.raises(ValueError, match="elbow_flex: range_max is missing, must be an integer"):
        calibration.load(write(tmp_path / "arm.json", data), MOTORS, 2047)


def test_missing_and_unknown_motors_are_named(tmp_path: Path) -> None:
    data = content()
    data["wrist"] = data.pop("wrist_roll")
    with pytest.raises(
        ValueError, match=r"lacks wrist_roll and has unknown wrist\. It must have exactly shoulder_pan"
    ):
        calibration.load(write(tmp_path / "arm.json", data), MOTORS, 2047)


@pytest.mark.parametrize("data", ["", "{", "[]", "3", '"x"', "\xff", '{"elbow_flex": 3}'])
def test_an_invalid_calibration_is_refused(tmp_path: Path, data: str) -> None:
    with pytest.raises(ValueError, match=r"arm\.json"):
        calibration.load(write(tmp_path / "arm.json", data), MOTORS, 2047)


def test_an_entry_that_is_no_object_is_refused() -> None:
    with pytest.raises(ValueError, match="here: gripper must be an object with id"):
        calibration.check(content() | {"gripper": 3}, MOTORS, 2047, "here")


def test_the_folder_is_lerobots(tmp_path: Path) -> None:
    home = {"HF_LEROBOT_HOME": "/le", "HF_HOME": "/hf"}
    assert calibration.folder({"HF_LEROBOT_CALIBRATION": "/cal", **home}) == Path("/cal")
    assert calibration.folder(home) == Path("/le/calibration")
    assert calibration.folder({"HF_HOME": "/hf"}) == Path("/hf/lerobot/calibration")
    assert calibration.folder({}) == Path("~/.cache/huggingface/lerobot/calibration").expanduser()


def test_find_takes_the_first_folder_that_has_the_robot(tmp_path: Path) -> None:
    assert calibration.find(("a", "b"), "blue", tmp_path) is None
    second = write(tmp_path / "robots" / "b" / "blue.json", {})
    assert calibration.find(("a", "b"), "blue", tmp_path) == second
    first = write(tmp_path / "robots" / "a" / "blue.json", {})
    assert calibration.find(("a", "b"), "blue", tmp_path) == first


@pytest.mark.parametrize("folder", ["so101_follower", "so_follower", "so101"])
def test_the_driver_finds_the_file_of_its_tool_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    path = write(tmp_path / "robots" / folder / "blue.json", content())
    resolved = Feetech.resolve("so101", {"tool_name": "blue"})
    driver = Feetech("so101", "p", resolved)
    assert driver.config.calibration_source == str(path)
    assert (driver.joints[0].low, driver.joints[0].high) == (700, 3300)


def test_without_a_file_the_status_reports_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    resolved = Feetech.resolve("so101", {"tool_name": "blue"})
    assert resolved["calibration"] is None
    assert resolved["calibration_source"] == "none: the travel of its model"


def test_a_path_that_was_given_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"gone\.json: cannot be read"):
        Feetech.resolve("so101", {"calibration": str(tmp_path / "gone.json")})


def test_a_calibration_may_be_a_path_or_a_dict(tmp_path: Path) -> None:
    path = write(tmp_path / "arm.json", content())
    from_path = Feetech.resolve("so101", {"calibration": path})
    from_dict = Feetech.resolve("so101", {"calibration": content()})
    assert from_path["calibration"] == from_dict["calibration"]
    assert from_path["calibration_source"] == str(path)
    assert from_dict["calibration_source"] == "given as a dict"
    with pytest.raises(ValueError, match=r"calibration is 3\. Give a path, a dict or None"):
        Feetech.resolve("so101", {"calibration": 3})


def test_an_endless_file_is_not_read(tmp_path: Path) -> None:
    """``/dev/zero`` once took 3.5 GB. A pipe without a writer would block."""
    os.mkfifo(tmp_path / "pipe")
    for path in (Path("/dev/zero"), tmp_path / "pipe", tmp_path):
        with pytest.raises(ValueError, match=r"cannot be read \(it is not a regular file\)"):
            calibration.load(path, MOTORS, 2047)
    long = write(tmp_path / "long.json", " " * (calibration.MAX_BYTES + 1))
    with pytest.raises(ValueError, match="longer than"):
        calibration.load(long, MOTORS, 2047)
    deep = write(tmp_path / "deep.json", "[" * 100_000)
    with pytest.raises(ValueError, match="cannot be read"):
        calibration.load(deep, MOTORS, 2047)
    with pytest.raises(ValueError, match="calibration"):
        Feetech.resolve("so101", {"calibration": "/dev/zero"})
