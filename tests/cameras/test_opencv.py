"""Cameras of type ``opencv``, on a stand-in for OpenCV's capture, because there is no device."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trio

from strands_actors.contract import CameraSettings, WireDown
from strands_actors.surfaces.cameras.opencv import open_with

V4L2, ANY = 200, 0


class Capture:
    """A device that gives 640 x 480 at 30 Hz with any settings, and the picture's number as red.
    ``kernel_ms`` is the time that it reports for a picture."""

    def __init__(self, module: StandIn, place: int | str, backend: int) -> None:
        self.module = module
        self.opened = (place, backend)
        self.calls: list[Any] = []
        self.count = 0

    def isOpened(self) -> bool:
        return self.module.is_there

    def set(self, what: str, value: float) -> bool:
        self.calls.append((what, value))
        return True

    def get(self, what: str) -> float:
        return {**self.module.has, "ms": self.module.kernel_ms(self.count)}[what]

    def grab(self) -> bool:
        self.count += 1
        return self.count <= self.module.pictures

    def retrieve(self) -> tuple[bool, Any]:
        image = np.zeros((480, 640, 3), np.uint8)
        image[:, :, 2] = self.count  # BGR
        return True, image

    def release(self) -> None:
        self.calls.append("release")


class StandIn:
    """The used part of the module ``cv2``."""

    CAP_ANY, CAP_V4L2 = ANY, V4L2
    CAP_PROP_BUFFERSIZE, CAP_PROP_FOURCC, CAP_PROP_POS_MSEC = "buffers", "fourcc", "ms"
    CAP_PROP_FRAME_WIDTH, CAP_PROP_FRAME_HEIGHT, CAP_PROP_FPS = "width", "height", "fps"
    COLOR_BGR2RGB = "bgr2rgb"

    def __init__(self, is_there: bool = True, pictures: int = 3, kernel_ms: Any = lambda count: 0.0) -> None:
        self.is_there = is_there
        self.pictures = pictures
        self.kernel_ms = kernel_ms
        self.has = {"width": 640.0, "height": 480.0, "fps": 30.0}
        self.made: list[Capture] = []

    def setNumThreads(self, count: int) -> None:
        assert count == 1

    def VideoCapture(self, place: int | str, backend: int) -> Capture:
        self.made.append(Capture(self, place, backend))
        return self.made[-1]

    def VideoWriter_fourcc(self, *letters: str) -> str:
        return "".join(letters)

    def cvtColor(self, image: Any, how: str) -> Any:
        assert how == self.COLOR_BGR2RGB
        return np.ascontiguousarray(image[:, :, ::-1])


def settings(**words: Any) -> CameraSettings:
    return CameraSettings(**{"name": "top", "type": "opencv", "index_or_path": 0, **words})


def test_a_device_is_set_up_format_first_and_read_in_rgb() -> None:
    cv2 = StandIn()
    words = {"fourcc": "MJPG", "width": 480, "height": 640, "fps": 30.0, "rotation": 90}
    source = open_with(settings(**words), cv2)
    (capture,) = cv2.made
    assert capture.opened == (0, V4L2)
    assert capture.calls == [("buffers", 1), ("fourcc", "MJPG"), ("width", 640), ("height", 480), ("fps", 30.0)]

    async def read() -> None:
        before_ns = time.monotonic_ns()
        first, second = await source.read(), await source.read()
        assert first.image.shape == (480, 640, 3)
        assert [picture.image[0, 0].tolist() for picture in (first, second)] == [[1, 0, 0], [2, 0, 0]]
        assert before_ns < first.captured_ns < second.captured_ns <= time.monotonic_ns()
        await source.read()
        with pytest.raises(WireDown, match=r"0 gives no more pictures\. Check that it is plugged in"):
            await source.read()
        await source.aclose()

    trio.run(read)
    assert capture.calls[-1] == "release"


@pytest.mark.parametrize(("behind_ms", "counts"), [(40.0, True), (-5.0, False), (5_000.0, False)])
def test_the_devices_time_is_used_if_it_is_on_our_clock(behind_ms: float, counts: bool) -> None:
    cv2 = StandIn(kernel_ms=lambda count: time.monotonic_ns() / 1e6 - behind_ms)
    source = open_with(settings(), cv2)
    before_ns = time.monotonic_ns()
    picture = trio.run(source.read)
    assert (picture.captured_ns < before_ns) == counts


def test_a_device_that_was_believed_once_is_believed_when_its_picture_is_old() -> None:
    """A picture waited in the device's buffer because the camera process did not read."""
    behind_ms = {1: 40.0, 2: 10_000.0, 3: 20.0}
    cv2 = StandIn(kernel_ms=lambda count: time.monotonic_ns() / 1e6 - behind_ms.get(count, 0.0))
    source = open_with(settings(), cv2)
    ages_s = [(time.monotonic_ns() - trio.run(source.read).captured_ns) / 1e9 for _ in range(3)]
    assert ages_s[0] < 1.0 and ages_s[2] < 1.0
    assert ages_s[1] > 9.9, "the picture is old, and its age is reported"


def test_a_missing_device_is_reported_with_the_present_ones() -> None:
    cv2 = StandIn(is_there=False)
    with pytest.raises(WireDown, match=r"/dev/video7 cannot be opened\. there (is no|are) /dev/video"):
        open_with(settings(index_or_path="/dev/video7"), cv2)
    assert cv2.made[0].opened == ("/dev/video7", V4L2)
    assert cv2.made[0].calls[-1] == "release", "the device is released for the next attempt"


@pytest.mark.parametrize(("word", "value"), [("fps", 60.0), ("width", 1280)])
def test_another_size_or_rate_than_the_requested_one_is_refused(word: str, value: float) -> None:
    cv2 = StandIn()
    with pytest.raises(WireDown, match=rf"0 gives {word} .* and {value:g} is asked for\. v4l2-ctl"):
        open_with(settings(**{"width": 640, "height": 480, word: value}), cv2)
    assert cv2.made[0].calls[-1] == "release"


def test_a_film_is_read_by_any_backend_at_the_requested_rate(tmp_path: Path) -> None:
    cv2 = StandIn(kernel_ms=lambda count: 33.3 * count)  # the time within the film, not the time of our clock
    film = tmp_path / "film.avi"
    film.touch()
    source = open_with(settings(index_or_path=str(film), fps=5.0), cv2)
    assert not source.paced
    assert cv2.made[0].opened == (str(film), ANY)
    assert time.monotonic_ns() - trio.run(source.read).captured_ns < 20e9
