"""``cameras=`` takes LeRobot's settings, which are checked before any process is started."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.resolve.planning import plan
from strands_actors.contract.cameras import CameraSettings
from strands_actors.surfaces.cameras.config import OPENCV, stale_s

TWIN = {"mode": "real", "transport": "twin"}
PORT = {"mode": "real", "port": "/dev/ttyACM0"}
FULL = {"type": "opencv", "index_or_path": 0, "fps": 30, "width": 640, "height": 480}


@pytest.fixture(autouse=True)
def opencv_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the check of the extra pass, whether it is installed or not. It is not imported here."""
    monkeypatch.setattr("strands_actors.surfaces.cameras.config.missing", lambda extra, use: "")


def settings(given: Any, **keywords: Any) -> CameraSettings:
    (found,) = plan("so101", **(keywords or PORT), cameras={"top": given}).cameras
    return found


def test_all_settings_of_lerobot_are_accepted() -> None:
    more = {"rotation": 90, "color_mode": "bgr", "fourcc": "MJPG", "warmup_s": 2, "backend": "V4L2"}
    found = settings({**FULL, **more})
    assert (found.name, found.type, found.index_or_path, found.fps) == ("top", OPENCV, 0, 30.0)
    assert (found.width, found.height, found.captured_size) == (640, 480, (480, 640))
    assert (found.rotation, found.color_mode, found.fourcc, found.backend) == (90, "bgr", "MJPG", 200)
    assert found.warmup_s == 2.0
    assert settings({"index_or_path": 0}).warmup_s == 1.0  # LeRobot's default
    assert settings({"index_or_path": 0, "warmup_s": 0}).warmup_s == 0.0


class _Rotation(enum.IntEnum):
    ROTATE_270 = -90


class _Color(enum.StrEnum):
    RGB = "rgb"


@dataclass
class _OpenCVCameraConfig:
    """A settings object like that of LeRobot."""

    index_or_path: int | Path = Path("/dev/video2")
    fps: int | None = 30
    width: int | None = 640
    height: int | None = 480
    color_mode: _Color = _Color.RGB
    rotation: _Rotation = _Rotation.ROTATE_270
    warmup_s: int = 1

    @property
    def type(self) -> str:
        return "opencv"


def test_an_object_of_lerobots_is_taken_too() -> None:
    found = settings(_OpenCVCameraConfig())
    assert (found.type, found.index_or_path, found.rotation) == (OPENCV, "/dev/video2", -90)


@pytest.mark.parametrize(("given", "is_at"), [("0", 0), (2, 2), (Path("/dev/video1"), "/dev/video1")])
def test_a_device_is_a_number_or_a_path(given: Any, is_at: int | str) -> None:
    assert settings({"index_or_path": given}).index_or_path == is_at


def test_a_twin_shows_its_scene_and_a_real_device_when_one_is_named() -> None:
    for keywords in (TWIN, {"mode": "sim"}):
        scene = settings({}, **keywords)
        assert (scene.type, scene.view, scene.width, scene.height) == ("scene", "top", 640, 480)
        assert settings({"index_or_path": 0}, **keywords).type == OPENCV
    (laptop,) = plan("so101", **TWIN, cameras={"laptop": {}}).cameras
    assert laptop.view == "front"  # any name is allowed, because a scene has no laptop
    assert plan("so101", **TWIN).cameras == ()


@pytest.mark.parametrize(("fps", "is_s"), [(None, 0.5), (30.0, 0.2), (5.0, 0.6)])
def test_a_picture_is_stale_after_three_periods_and_not_before_200_ms(fps: float | None, is_s: float) -> None:
    assert stale_s(settings({**FULL, "fps": fps})) == pytest.approx(is_s)


WRONG = [
    ({"top": 0}, "camera 'top' is 0. Give its settings"),
    (
        {"top": {"index_or_path": 0, "fsp": 30}},
        r"has no setting 'fsp' \('fsp' -> 'fps'\?\). Use type, index_or_path",
    ),
    ({"top": {}}, "index_or_path is None. Give the camera's number .* path below /dev/v4l/by-id"),
    ({"top": {**FULL, "index_or_path": -1}}, "index_or_path is -1"),
    ({"top": {**FULL, "index_or_path": -2}}, "index_or_path is -2"),
    ({"top": {**FULL, "index_or_path": True}}, "index_or_path is True"),
    ({"top": {**FULL, "fps": 0}}, "fps is 0. Give a number from 0.1 to 240"),
    ({"top": {**FULL, "fps": float("nan")}}, "fps is nan"),
    ({"top": {**FULL, "fps": "30"}}, "fps is '30'"),
    ({"top": {**FULL, "width": None}}, "width is None and height 480. Give both, or neither"),
    ({"top": {**FULL, "width": 1e3}}, r"width is 1000\.0. Give pixels, a whole number"),
    ({"top": {**FULL, "height": 100000}}, "height is 100000"),
    ({"top": {**FULL, "rotation": 45}}, "rotation is 45. Use 0, 90, 180 or -90"),
    ({"top": {**FULL, "color_mode": "hsv"}}, "color_mode is 'hsv'. Use rgb or bgr"),
    ({"top": {**FULL, "fourcc": "MJPEG"}}, "fourcc is 'MJPEG'. Give four letters"),
    ({"top": {**FULL, "backend": 700}}, r"backend is '700'. Use 0 or 200 \(V4L2\)"),
    ({"top": {**FULL, "warmup_s": -1}}, "warmup_s is -1"),
    ({"top": {**FULL, "view": "front"}}, "which has no views. Leave out view"),
    ({"top": {"type": "intelrealsense"}}, "which this version does not support. .* V4L2 device, too"),
    (
        {"top": {"type": "usb"}},
        "is of type 'usb'. Use opencv, scene, robot, or your own function as module:function",
    ),
    ({"top": {"type": ["usb"]}}, r"is of type \['usb'\]. Use opencv"),
    ({"top": {"type": "mod:"}}, "is of type 'mod:'. Use opencv"),
    ({"top": {"type": ":f"}}, "is of type ':f'. Use opencv"),
    ({"top": {"type": "scene"}}, "a real robot has no simulated scene. Use 'opencv'"),
    ({"top": {"type": "robot"}}, "this robot provides no pictures itself"),
    ({"top": {"type": "a:b", "fourcc": "MJPG"}}, "does not use fourcc"),
    ({"gripper": FULL}, "a camera is named 'gripper', and so is an axis"),
    ({"a/b": FULL}, "a camera is named 'a/b'. Use a letter"),
    ({1: FULL}, "a camera is named 1"),
    ({f"c{number}": FULL for number in range(9)}, "9 cameras. Give at most 8"),
]


@pytest.mark.parametrize(("given", "text"), WRONG)
def test_an_invalid_setting_is_refused_by_name(given: Any, text: str) -> None:
    with pytest.raises((TypeError, ValueError), match=text):
        Robot("so101", **PORT, cameras=given)


def test_cameras_are_one_entry_each() -> None:
    with pytest.raises(TypeError, match=r"cameras is \[0\]. Give one entry for each camera"):
        Robot("so101", **PORT, cameras=[0])


def test_without_opencv_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    from strands_actors.contract import extras

    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setattr("strands_actors.surfaces.cameras.config.missing", extras.missing)
    with pytest.raises(ValueError, match=r"needs cv2\. pip install 'strands-actors\[cameras\]'"):
        Robot("so101", **PORT, cameras={"top": FULL})
    assert Robot("so101", **TWIN, cameras={"top": {}}) is not None  # a scene does not need it
