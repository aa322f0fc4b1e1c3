"""The image service of the simulated Spot: its cameras, and the pictures that it answers.

Sizes and focal lengths of the body's cameras are those that owners of a Spot have published from
``list_image_sources``. Where each camera sits, and the lenses of the hand's cameras, is [assumed]. As on the robot,
the front cameras are mounted on their side, and the right one upside down (example get_image).

OpenCV encodes JPEG. Without the extra ``cameras`` the sources offer raw pictures only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

from strands_actors.contract.extras import missing
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message

from . import pictures
from .frames import frames_of
from .geometry import Pose, pose_at
from .mechanism import Mechanism
from .pictures import Lens
from .reports import Reports

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

JPEG, RAW = 1, 2
"""Formats of a picture. A third one, RLE, is not modelled."""
GREY, RGB, DEPTH = 1, 3, 5
"""Formats of a pixel: one byte, three bytes, or 16 bits of millimetres."""
VISUAL_TYPE, DEPTH_TYPE = 1, 2
MM_IN_M = 1000.0
UNKNOWN_CAMERA, NO_DATA, NO_FORMAT, NO_PIXEL_FORMAT, NO_RATIO = 2, 4, 5, 6, 7
"""Statuses of ``ImageResponse`` other than 1 (success)."""
MOST_BYTES = 8 << 20
"""Most bytes of the pictures of one answer. All sources together, without JPEG, have fewer [assumed]."""

_FISHEYE, _STEREO = Lens(640, 480, 257.0), Lens(424, 240, 213.0)
_HAND_COLOUR, _HAND_DEPTH = Lens(640, 480, 552.0), Lens(224, 171, 210.0)
_HEAD, _WRIST = "head", "arm0.link_wr1"
_QUARTER = math.pi / 2


class Camera(NamedTuple):
    """One camera: the frame to which it is mounted, and its pose there."""

    parent: str
    pose: Pose


class Source(NamedTuple):
    """One source of pictures."""

    frame: str
    lens: Lens
    pixels: int
    """The default format of a pixel."""


def _mounted(x: float, y: float, z: float, yaw: float, down: float, roll: float = 0.0) -> Pose:
    """Return the pose of a camera from its place, and from the direction in which it looks.

    Args:
        x, y, z: Metres.
        yaw: To the left, radians.
        down: Downwards, radians.
        roll: By how much it is turned about its optical axis, clockwise as it sees it, radians.
    """
    looking = pose_at(x, y, z, pitch=down, yaw=yaw)
    # The z axis of a camera points forwards, its x axis to the right.
    optical = pose_at(0.0, 0.0, 0.0, roll=-_QUARTER, yaw=-_QUARTER)
    return looking.compose(optical).compose(pose_at(0.0, 0.0, 0.0, yaw=roll))


_OF_THE_BODY = {
    "back": _mounted(-0.42, 0.0, 0.0, math.pi, 0.5),
    "frontleft": _mounted(0.41, 0.04, 0.02, 0.35, 0.6, _QUARTER),
    "frontright": _mounted(0.41, -0.04, 0.02, -0.35, 0.6, _QUARTER),
    "left": _mounted(-0.16, 0.11, 0.03, _QUARTER, 0.5),
    "right": _mounted(-0.16, -0.11, 0.03, -_QUARTER, 0.5, math.pi),
}
_OF_THE_HAND = {
    "hand_color_image_sensor": _mounted(0.14, 0.02, 0.03, 0.0, math.radians(-9.0)),
    "hand_depth_sensor": _mounted(0.14, 0.0, 0.03, 0.0, math.radians(-9.0)),
}


def cameras_of(has_arm: bool) -> Mapping[str, Camera]:
    """Return the cameras by the names of their frames."""
    cameras = {"head": Camera("body", Pose())}
    for name, pose in _OF_THE_BODY.items():
        cameras |= {name: Camera(_HEAD, pose), f"{name}_fisheye": Camera(name, Pose())}
    if has_arm:
        cameras |= {name: Camera(_WRIST, pose) for name, pose in _OF_THE_HAND.items()}
    return cameras


def sources_of(has_arm: bool) -> Mapping[str, Source]:
    """Return the sources of pictures by their names."""
    sources = {}
    for name in _OF_THE_BODY:
        sources[f"{name}_depth"] = Source(name, _STEREO, DEPTH)
        sources[f"{name}_depth_in_visual_frame"] = Source(f"{name}_fisheye", _FISHEYE, DEPTH)
        sources[f"{name}_fisheye_image"] = Source(f"{name}_fisheye", _FISHEYE, GREY)
    if has_arm:
        colour, depth = _OF_THE_HAND
        sources["hand_color_image"] = Source(colour, _HAND_COLOUR, RGB)
        sources["hand_color_in_hand_depth_frame"] = Source(depth, _HAND_DEPTH, RGB)
        sources["hand_depth"] = Source(depth, _HAND_DEPTH, DEPTH)
        sources["hand_depth_in_hand_color_frame"] = Source(colour, _HAND_COLOUR, DEPTH)
        sources["hand_image"] = Source(depth, _HAND_DEPTH, GREY)
    return sources


class ImageService:
    """The image service.

    Args:
        mechanism: The body.
        has_arm: True if the robot has an arm, with its cameras.
        reports: The robot's state, for its frames.
        robot_ns: The robot's clock.
    """

    def __init__(self, mechanism: Mechanism, has_arm: bool, reports: Reports, robot_ns: Callable[[], int]) -> None:
        self._mechanism = mechanism
        self._has_arm = has_arm
        self._reports = reports
        self._robot_ns = robot_ns
        self._cameras = cameras_of(has_arm)
        self._sources = sources_of(has_arm)

    def listed(self) -> Message:
        """Return the reply to ``ListImageSources``."""
        sources = [_described(name, source.lens, source.pixels) for name, source in self._sources.items()]
        return {"image_sources": sources, "transforms_snapshot": self._frame_tree()}

    def pictures(self, requests: list[Message]) -> Message:
        """Return the reply to ``GetImage``."""
        return {"image_responses": list(self._responses(requests))}

    def _responses(self, requests: list[Message]) -> Iterator[Message]:
        left = MOST_BYTES
        for request in requests:
            response = self._response(request, left)
            left -= len(response.get("shot", {}).get("image", {}).get("data", b""))
            yield response

    def _response(self, request: Message, most_bytes: int) -> Message:
        name = request.get("image_source_name", "")
        if name not in self._sources:
            return {"status": UNKNOWN_CAMERA}
        source = self._sources[name]
        pixels = _pixels(source, request)
        if pixels is None:
            return {"status": NO_PIXEL_FORMAT}
        encoding = request.get("image_format", 0) or _encodings(pixels)[0]
        if encoding not in _encodings(pixels):
            return {"status": NO_FORMAT}
        ratio = request.get("resize_ratio", 0.0) or 1.0
        if not 0.0 < ratio <= 1.0:
            return {"status": NO_RATIO}
        lens = source.lens.resized(ratio)
        data = self._taken(source.frame, lens, pixels, encoding, request.get("quality_percent", 0.0))
        described = _described(name, lens, source.pixels)
        if len(data) > most_bytes:
            return {"status": NO_DATA, "source": described}
        image = {
            "cols": lens.columns,
            "rows": lens.rows,
            "data": data,
            "format": encoding,
            "pixel_format": pixels,
        }
        shot = {
            "acquisition_time": p.stamp(self._robot_ns()),
            "transforms_snapshot": self._frame_tree(),
            "frame_name_image_sensor": source.frame,
            "image": image,
        }
        return {"shot": shot, "source": described, "status": p.OK}

    def _taken(self, frame: str, lens: Lens, pixels: int, encoding: int, quality_percent: float) -> bytes:
        camera = self._pose_of(frame)
        if pixels == DEPTH:
            return pictures.depth(lens, camera).tobytes()
        picture = pictures.grey(lens, camera) if pixels == GREY else pictures.colour(lens, camera)
        return picture.tobytes() if encoding == RAW else jpeg(picture, quality_percent)

    def _pose_of(self, frame: str) -> Pose:
        """Return the pose of a camera, relative to the place on the floor where the robot started."""
        camera = self._cameras.get(frame)
        if camera is None:
            return frames_of(self._mechanism, self._has_arm)[frame]
        return self._pose_of(camera.parent).compose(camera.pose)

    def _frame_tree(self) -> Message:
        return self._reports.frame_tree(self._cameras)


def _pixels(source: Source, request: Message) -> int | None:
    """Return the format of a pixel for a request; None if the source has none of the formats that it names."""
    requested = request.get("pixel_format", 0)
    if not requested:
        return source.pixels
    requested_formats = (requested, *request.get("fallback_formats", ()))
    return next((pixels for pixels in requested_formats if pixels in _pixel_formats(source.pixels)), None)


def _pixel_formats(pixels: int) -> tuple[int, ...]:
    return (RGB, GREY) if pixels == RGB else (pixels,)


def _encodings(pixels: int) -> tuple[int, ...]:
    return (RAW,) if pixels == DEPTH or missing("cameras", "JPEG") else (JPEG, RAW)


def jpeg(picture: NDArray[np.uint8], quality_percent: float) -> bytes:
    """Return a picture as a JPEG file.

    Args:
        picture: Rows and columns of grey values, or of red, green and blue.
        quality_percent: 0 is the worst, 100 the best.
    """
    import cv2

    pixels = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, round(quality_percent)])
    return bytes(data)


def _described(name: str, lens: Lens, pixels: int) -> Message:
    """Return the message ``ImageSource``."""
    centre_x, centre_y = lens.centre
    intrinsics = {
        "focal_length": {"x": lens.focal, "y": lens.focal},
        "principal_point": {"x": centre_x, "y": centre_y},
        "skew": {},
    }
    return {
        "name": name,
        "cols": lens.columns,
        "rows": lens.rows,
        **({"depth_scale": MM_IN_M} if pixels == DEPTH else {}),
        "pinhole": {"intrinsics": intrinsics},
        "image_type": DEPTH_TYPE if pixels == DEPTH else VISUAL_TYPE,
        "pixel_formats": list(_pixel_formats(pixels)),
        "image_formats": list(_encodings(pixels)),
    }
