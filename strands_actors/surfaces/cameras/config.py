"""Check ``cameras={"wrist": {...}}`` of ``Robot(...)``. The keys are those of LeRobot's configurations."""

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
    given: object, *, driver_class: type[Any], axes: Sequence[str], simulated: bool
) -> tuple[CameraSettings, ...]:
    """Return the settings of each camera.

    Args:
        given: The ``cameras`` argument.
        driver_class: The robot's driver.
        axes: Its axes, whose names a camera must not have.
        simulated: True if there is a scene, of a twin or a simulation.

    Raises:
        TypeError: ``given`` is not a mapping.
        ValueError: A setting is wrong. The text names values that would be accepted.
    """
    if given is None:
        return ()
    if not isinstance(given, Mapping):
        raise TypeError(
            f"Robot: cameras is {given!r}. give one entry a camera: "
            "cameras={'wrist': {'index_or_path': 0, 'fps': 30, 'width': 640, 'height': 480}}"
        )
    if len(given) > MOST:
        raise ValueError(f"Robot: {len(given)} cameras. give at most {MOST}")
    for name in given:
        if not isinstance(name, str) or not NAME.match(name):
            raise ValueError(f"Robot: a camera is named {name!r}. use a letter, then 0 to 31 of A-Z a-z 0-9 _ -")
        if name in axes:
            raise ValueError(f"Robot: a camera is named {name!r}, and so is an axis. use another name")
    return tuple(_camera(name, words, driver_class, simulated) for name, words in given.items())


def stale_s(settings: CameraSettings) -> float:
    """Return the age from which a picture is stale: three periods, and at least 0.2 s."""
    return UNKNOWN_STALE_S if settings.fps is None else max(STALE_S, STALE_PERIODS / settings.fps)


def source_of(settings: CameraSettings, driver_class: type[Any]) -> str:
    """Return the ``module:function`` that opens a camera."""
    if settings.type == ROBOT:
        return str(driver_class.CAMERAS[settings.view])
    return SOURCES.get(settings.type, settings.type)


def _camera(name: str, given: object, driver_class: type[Any], simulated: bool) -> CameraSettings:
    who = f"Robot: camera {name!r}"
    words = {key: as_python(value) for key, value in _plain(who, given).items()}
    for word in words:
        if word not in WORDS:
            close = difflib.get_close_matches(str(word), WORDS, n=1)
            hint = f" ({word!r} -> {close[0]!r}?)" if close else ""
            raise ValueError(f"{who} takes no {word!r}{hint}. it takes {', '.join(WORDS)}")
    own = tuple(getattr(driver_class, "CAMERAS", {}))
    kind = _type(who, words, own, simulated)
    if kind != OPENCV and (idle := [word for word in OF_DEVICES if words.get(word) is not None]):
        raise ValueError(f"{who} is of type {kind!r}, which has no use for {', '.join(idle)}. leave that out")
    width, height = _size(who, words)
    if kind == SCENE and width is None:
        width, height = DEFAULT_SIZE
    return CameraSettings(
        name=name,
        type=kind,
        view=_view(who, name, words, kind, own),
        index_or_path=_place(who, words.get("index_or_path")) if kind == OPENCV else "",
        fps=_number(who, "fps", words.get("fps"), 0.1, MAX_FPS),
        width=width,
        height=height,
        rotation=_chosen(who, "rotation", _degrees(words.get("rotation", 0)), ROTATIONS, "0, 90, 180 or -90"),
        color_mode=_chosen(who, "color_mode", _word(words.get("color_mode", "rgb")), {"rgb": "rgb", "bgr": "bgr"}),
        fourcc=_fourcc(who, words.get("fourcc")),
        backend=_chosen(who, "backend", str(words.get("backend") or 0).upper(), BACKENDS, "0 or 200 (V4L2)"),
        warmup_s=_number(who, "warmup_s", words.get("warmup_s"), 0.0, 60.0)
        or (WARMUP_S if kind == OPENCV and words.get("warmup_s") is None else 0.0),
    )


def _plain(who: str, given: object) -> dict[str, Any]:
    """Return a camera's settings as a dict. A configuration object of LeRobot is accepted, too."""
    if isinstance(given, Mapping):
        return dict(given)
    if hasattr(given, "__dataclass_fields__"):
        fields = {name: getattr(given, name) for name in given.__dataclass_fields__}
        return {"type": getattr(given, "type", OPENCV), **fields}
    raise ValueError(
        f"{who} is {given!r}. give its settings: {{'index_or_path': 0, 'fps': 30, 'width': 640, 'height': 480}}"
    )


def _type(who: str, words: Mapping[str, Any], own: Sequence[str], simulated: bool) -> str:
    kind = words.get("type")
    if kind is None:
        kind = OPENCV if words.get("index_or_path") is not None or not (simulated or own) else ""
        kind = kind or (ROBOT if own else SCENE)
    if isinstance(kind, str) and kind in NOT_READ:
        raise ValueError(f"{who} is of type {kind!r}, which this version does not read. {NOT_READ[kind]}")
    if not isinstance(kind, str) or (kind not in (OPENCV, SCENE, ROBOT) and not all(kind.partition(":"))):
        raise ValueError(
            f"{who} is of type {kind!r}. use {OPENCV}, {SCENE}, {ROBOT}, or module:function of your own"
        )
    if kind == SCENE and not simulated:
        raise ValueError(f"{who} is of type {SCENE!r}, and a real robot has none. use {OPENCV!r}")
    if kind == ROBOT and not own:
        raise ValueError(f"{who} is of type {ROBOT!r}, and this robot's service gives no pictures. use {OPENCV!r}")
    if kind in (OPENCV, ROBOT) and (why := missing("cameras", "a camera")):
        raise ValueError(f"{who}: {why}")
    return kind


def _view(who: str, name: str, words: Mapping[str, Any], kind: str, own: Sequence[str]) -> str:
    view = words.get("view")
    if kind == OPENCV:
        if view is not None:
            raise ValueError(f"{who} is of type {kind!r}, which has one picture. leave out view")
        return ""
    if view is None:
        views = own if kind == ROBOT else VIEWS
        return name if name in views else (own[0] if kind == ROBOT else DEFAULT_VIEW)
    if not isinstance(view, str) or not view or len(view) > 64:
        raise ValueError(f"{who}: view is {view!r}. give the name of one: {', '.join(own or VIEWS)}")
    if kind == ROBOT and view not in own:
        raise ValueError(f"{who}: view is {view!r}. this robot has {', '.join(own)}")
    return view


def _place(who: str, given: object) -> int | str:
    if isinstance(given, os.PathLike):
        given = os.fspath(given)
    if isinstance(given, str) and given.isdecimal():
        given = int(given)
    if isinstance(given, int) and not isinstance(given, bool) and given >= 0:
        return given
    if isinstance(given, str) and given:
        return given
    raise ValueError(
        f"{who}: index_or_path is {given!r}. give its number (0) or its path ('/dev/video0'); "
        "a path below /dev/v4l/by-id stays the same when it is plugged in again"
    )


def _size(who: str, words: Mapping[str, Any]) -> tuple[int | None, int | None]:
    sides = [words.get("width"), words.get("height")]
    if sides == [None, None]:
        return None, None
    if None in sides:
        raise ValueError(f"{who}: width is {sides[0]!r} and height {sides[1]!r}. give both, or neither")
    for word, side in zip(("width", "height"), sides, strict=True):
        if isinstance(side, bool) or not isinstance(side, int) or not 16 <= side <= MAX_SIDE:
            raise ValueError(f"{who}: {word} is {side!r}. give pixels, a whole number from 16 to {MAX_SIDE}")
    return sides[0], sides[1]


def _number(who: str, word: str, given: object, least: float, most: float) -> float | None:
    if given is None:
        return None
    if isinstance(given, bool) or not isinstance(given, int | float) or not math.isfinite(given):
        raise ValueError(f"{who}: {word} is {given!r}. give a number from {least:g} to {most:g}")
    if not least <= given <= most:
        raise ValueError(f"{who}: {word} is {given!r}. give a number from {least:g} to {most:g}")
    return float(given)


def _chosen(who: str, word: str, given: object, choices: Mapping[Any, Any], shown: str = "") -> Any:
    try:
        return choices[given]
    except (KeyError, TypeError):
        raise ValueError(f"{who}: {word} is {given!r}. use {shown or ' or '.join(map(str, choices))}") from None


def _word(given: object) -> object:
    """Return a text in lower case. A member of one of LeRobot's enumerations counts as its value."""
    value = getattr(given, "value", given)
    return value.lower() if isinstance(value, str) else value


def _degrees(given: object) -> object:
    value = getattr(given, "value", given)
    if value is None:
        return 0
    return int(value) if isinstance(value, str) and value.removeprefix("-").isdecimal() else value


def _fourcc(who: str, given: object) -> str | None:
    if given is None:
        return None
    if not isinstance(given, str) or len(given) != 4 or not given.isascii():
        raise ValueError(f"{who}: fourcc is {given!r}. give four letters, like 'MJPG'")
    return given
