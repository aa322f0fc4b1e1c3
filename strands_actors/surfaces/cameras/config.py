"""Check the argument ``cameras={"wrist": {...}}`` of ``Robot(...)``. A camera's keys are the same as in
LeRobot's camera configurations."""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.contract.cameras import CameraSettings
from strands_actors.contract.extras import missing
from strands_actors.contract.plain_numbers import as_python

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,31}\Z")
MOST = 8
"""Most cameras of one robot."""
MAX_SIDE = 4096
MAX_FPS = 240.0

OPENCV, SCENE, ROBOT = "opencv", "scene", "robot"
SOURCES: Mapping[str, str] = {
    OPENCV: "strands_actors.surfaces.cameras.opencv:open_camera",
    SCENE: "strands_actors.drivers.sim.pictures:open_camera",
}
"""The function that opens a camera, by type. For ``robot`` the driver names it, and a type of the form
``module:function`` is used unchanged."""

NOT_READ = {
    "intelrealsense": "a depth camera's colour is a V4L2 device, too: use type 'opencv' with its path",
    "zmq": "use type 'opencv' on the host that has the camera",
    "reachy2_camera": "use type 'opencv' on the robot's computer",
}
"""Camera types of LeRobot that are not supported here, and the remedy."""

WORDS: Mapping[str, str] = {
    "type": "opencv, scene or robot",
    "index_or_path": "0, or /dev/video0",
    "fps": "pictures a second",
    "width": "pixels, after rotation",
    "height": "pixels, after rotation",
    "color_mode": "rgb or bgr",
    "rotation": "0, 90, 180 or -90, clockwise",
    "warmup_s": "seconds whose pictures are not used",
    "fourcc": "MJPG, YUYV: how the device is to send them",
    "backend": "0, or 200 for V4L2",
    "view": "which picture, of a scene or of the robot's own cameras",
}
OF_DEVICES = ("index_or_path", "fourcc", "backend")
"""Keys that only ``opencv`` uses."""
VIEWS = ("wrist", "front", "side", "top")
"""Views of a scene. A scene without an arm has no ``wrist``."""
DEFAULT_VIEW = "front"

ROTATIONS = {0: 0, 90: 90, 180: 180, -90: -90, 270: -90}
BACKENDS = {"0": 0, "ANY": 0, "200": 200, "V4L2": 200}
DEFAULT_SIZE = 640, 480
WARMUP_S = 1.0
"""Default for a device, as in LeRobot."""
STALE_S = 0.2
STALE_PERIODS = 3
UNKNOWN_STALE_S = 0.5
"""Age from which a picture is stale, for a camera without a configured rate."""


def read_cameras(
    cameras: object, *, driver_class: type[Any], axes: Sequence[str], simulated: bool
) -> tuple[CameraSettings, ...]:
    """Return the settings of each camera.

    Args:
        cameras: The ``cameras`` argument.
        driver_class: The robot's driver.
        axes: The robot's axes. No camera may have the name of an axis.
        simulated: True if the robot is simulated, so that cameras can show the simulated scene.

    Raises:
        TypeError: ``cameras`` is not a mapping.
        ValueError: A setting is wrong. The message names accepted values.
    """
    if cameras is None:
        return ()
    if not isinstance(cameras, Mapping):
        raise TypeError(
            f"Robot: cameras is {cameras!r}. Give one entry for each camera: "
            "cameras={'wrist': {'index_or_path': 0, 'fps': 30, 'width': 640, 'height': 480}}"
        )
    if len(cameras) > MOST:
        raise ValueError(f"Robot: {len(cameras)} cameras. Give at most {MOST}")
    for name in cameras:
        if not isinstance(name, str) or not NAME.match(name):
            raise ValueError(f"Robot: a camera is named {name!r}. Use a letter, then 0 to 31 of A-Z a-z 0-9 _ -")
        if name in axes:
            raise ValueError(f"Robot: a camera is named {name!r}, and so is an axis. Use another name")
    return tuple(_camera(name, words, driver_class, simulated) for name, words in cameras.items())


def stale_s(settings: CameraSettings) -> float:
    """Return the age in seconds from which a picture counts as stale: three periods of the camera, and at least
    0.2 s."""
    return UNKNOWN_STALE_S if settings.fps is None else max(STALE_S, STALE_PERIODS / settings.fps)


def source_of(settings: CameraSettings, driver_class: type[Any]) -> str:
    """Return the function that opens a camera of this type, as ``module:function``."""
    if settings.type == ROBOT:
        return str(driver_class.CAMERAS[settings.view])
    return SOURCES.get(settings.type, settings.type)


def _camera(name: str, settings: object, driver_class: type[Any], simulated: bool) -> CameraSettings:
    camera = f"Robot: camera {name!r}"
    words = {key: as_python(value) for key, value in _plain(camera, settings).items()}
    for word in words:
        if word not in WORDS:
            close = difflib.get_close_matches(str(word), WORDS, n=1)
            hint = f" ({word!r} -> {close[0]!r}?)" if close else ""
            raise ValueError(f"{camera} has no setting {word!r}{hint}. Use {', '.join(WORDS)}")
    own = tuple(getattr(driver_class, "CAMERAS", {}))
    camera_type = _type(camera, words, own, simulated)
    if camera_type != OPENCV and (idle := [word for word in OF_DEVICES if words.get(word) is not None]):
        raise ValueError(
            f"{camera} is of type {camera_type!r}, which does not use {', '.join(idle)}. Leave that out"
        )
    width, height = _size(camera, words)
    if camera_type == SCENE and width is None:
        width, height = DEFAULT_SIZE
    return CameraSettings(
        name=name,
        type=camera_type,
        view=_view(camera, name, words, camera_type, own),
        index_or_path=_place(camera, words.get("index_or_path")) if camera_type == OPENCV else "",
        fps=_number(camera, "fps", words.get("fps"), 0.1, MAX_FPS),
        width=width,
        height=height,
        rotation=_chosen(camera, "rotation", _degrees(words.get("rotation", 0)), ROTATIONS, "0, 90, 180 or -90"),
        color_mode=_chosen(
            camera, "color_mode", _word(words.get("color_mode", "rgb")), {"rgb": "rgb", "bgr": "bgr"}
        ),
        fourcc=_fourcc(camera, words.get("fourcc")),
        backend=_chosen(camera, "backend", str(words.get("backend") or 0).upper(), BACKENDS, "0 or 200 (V4L2)"),
        warmup_s=_number(camera, "warmup_s", words.get("warmup_s"), 0.0, 60.0)
        or (WARMUP_S if camera_type == OPENCV and words.get("warmup_s") is None else 0.0),
    )


def _plain(camera: str, settings: object) -> dict[str, Any]:
    """Return a camera's settings as a dict. A configuration object of LeRobot is accepted, too."""
    if isinstance(settings, Mapping):
        return dict(settings)
    if hasattr(settings, "__dataclass_fields__"):
        fields = {name: getattr(settings, name) for name in settings.__dataclass_fields__}
        return {"type": getattr(settings, "type", OPENCV), **fields}
    raise ValueError(
        f"{camera} is {settings!r}. "
        "Give its settings: {'index_or_path': 0, 'fps': 30, 'width': 640, 'height': 480}"
    )


def _type(camera: str, words: Mapping[str, Any], own: Sequence[str], simulated: bool) -> str:
    camera_type = words.get("type")
    if camera_type is None:
        camera_type = OPENCV if words.get("index_or_path") is not None or not (simulated or own) else ""
        camera_type = camera_type or (ROBOT if own else SCENE)
    if isinstance(camera_type, str) and camera_type in NOT_READ:
        raise ValueError(
            f"{camera} is of type {camera_type!r}, which this version does not support. {NOT_READ[camera_type]}"
        )
    if not isinstance(camera_type, str) or (
        camera_type not in (OPENCV, SCENE, ROBOT) and not all(camera_type.partition(":"))
    ):
        raise ValueError(
            f"{camera} is of type {camera_type!r}. "
            f"Use {OPENCV}, {SCENE}, {ROBOT}, or your own function as module:function"
        )
    if camera_type == SCENE and not simulated:
        raise ValueError(f"{camera} is of type {SCENE!r}, and a real robot has no simulated scene. Use {OPENCV!r}")
    if camera_type == ROBOT and not own:
        raise ValueError(
            f"{camera} is of type {ROBOT!r}, and this robot provides no pictures itself. Use {OPENCV!r}"
        )
    if camera_type in (OPENCV, ROBOT) and (reason := missing("cameras", "a camera")):
        raise ValueError(f"{camera}: {reason}")
    return camera_type


def _view(camera: str, name: str, words: Mapping[str, Any], camera_type: str, own: Sequence[str]) -> str:
    view = words.get("view")
    if camera_type == OPENCV:
        if view is not None:
            raise ValueError(f"{camera} is of type {camera_type!r}, which has no views. Leave out view")
        return ""
    if view is None:
        views = own if camera_type == ROBOT else VIEWS
        return name if name in views else (own[0] if camera_type == ROBOT else DEFAULT_VIEW)
    if not isinstance(view, str) or not view or len(view) > 64:
        raise ValueError(f"{camera}: view is {view!r}. Give the name of a view: {', '.join(own or VIEWS)}")
    if camera_type == ROBOT and view not in own:
        raise ValueError(f"{camera}: view is {view!r}. This robot has the views {', '.join(own)}")
    return view


def _place(camera: str, index_or_path: object) -> int | str:
    if isinstance(index_or_path, os.PathLike):
        index_or_path = os.fspath(index_or_path)
    if isinstance(index_or_path, str) and index_or_path.isdecimal():
        index_or_path = int(index_or_path)
    if isinstance(index_or_path, int) and not isinstance(index_or_path, bool) and index_or_path >= 0:
        return index_or_path
    if isinstance(index_or_path, str) and index_or_path:
        return index_or_path
    raise ValueError(
        f"{camera}: index_or_path is {index_or_path!r}. Give the camera's number (0) or path ('/dev/video0'). "
        "A path below /dev/v4l/by-id stays the same after the camera is unplugged"
    )


def _size(camera: str, words: Mapping[str, Any]) -> tuple[int | None, int | None]:
    sides = [words.get("width"), words.get("height")]
    if sides == [None, None]:
        return None, None
    if None in sides:
        raise ValueError(f"{camera}: width is {sides[0]!r} and height {sides[1]!r}. Give both, or neither")
    for word, side in zip(("width", "height"), sides, strict=True):
        if isinstance(side, bool) or not isinstance(side, int) or not 16 <= side <= MAX_SIDE:
            raise ValueError(f"{camera}: {word} is {side!r}. Give pixels, a whole number from 16 to {MAX_SIDE}")
    return sides[0], sides[1]


def _number(camera: str, word: str, setting: object, least: float, most: float) -> float | None:
    if setting is None:
        return None
    if isinstance(setting, bool) or not isinstance(setting, int | float) or not math.isfinite(setting):
        raise ValueError(f"{camera}: {word} is {setting!r}. Give a number from {least:g} to {most:g}")
    if not least <= setting <= most:
        raise ValueError(f"{camera}: {word} is {setting!r}. Give a number from {least:g} to {most:g}")
    return float(setting)


def _chosen(camera: str, word: str, setting: object, choices: Mapping[Any, Any], shown: str = "") -> Any:
    try:
        return choices[setting]
    except (KeyError, TypeError):
        raise ValueError(
            f"{camera}: {word} is {setting!r}. Use {shown or ' or '.join(map(str, choices))}"
        ) from None


def _word(setting: object) -> object:
    """Return a setting in lower case if it is text. A member of a LeRobot enumeration is replaced by its
    value."""
    value = getattr(setting, "value", setting)
    return value.lower() if isinstance(value, str) else value


def _degrees(setting: object) -> object:
    value = getattr(setting, "value", setting)
    if value is None:
        return 0
    return int(value) if isinstance(value, str) and value.removeprefix("-").isdecimal() else value


def _fourcc(camera: str, setting: object) -> str | None:
    if setting is None:
        return None
    if not isinstance(setting, str) or len(setting) != 4 or not setting.isascii():
        raise ValueError(f"{camera}: fourcc is {setting!r}. Give four letters, like 'MJPG'")
    return setting
