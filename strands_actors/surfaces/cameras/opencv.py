"""Cameras of type ``opencv``: what V4L2 gives, or a file or stream that OpenCV reads.

Only the camera's process imports OpenCV. Its calls go to a thread: some of them wait for the device.
"""

from __future__ import annotations

import glob
import os
import time
from typing import TYPE_CHECKING, Any, TypeVar

import trio

from strands_actors.contract.cameras import CameraSettings, Picture
from strands_actors.contract.wire import WireDown

if TYPE_CHECKING:
    from collections.abc import Callable

T = TypeVar("T")

TRUSTED_NS = 1_000_000_000
"""A device's own time of a picture counts once it was no older than this: it is on our clock then,
and a picture that is older has waited in its buffer."""
_MS = 1_000_000


class Unfit(WireDown):
    """The device does not take what was asked for."""


class OpenCVSource:
    """``capture``: a ``cv2.VideoCapture`` that is open. ``cv2``: the module."""

    def __init__(self, capture: Any, cv2: Any, place: int | str) -> None:
        self._capture = capture
        self._cv2 = cv2
        self._place = place
        self._is_on_our_clock = False
        self.paced = not _is_file(place)  # a file gives all it has at once

    async def read(self) -> Picture:
        return await _in_thread(self._read)

    async def aclose(self) -> None:
        await _in_thread(self._capture.release)

    def _read(self) -> Picture:
        if not self._capture.grab():
            raise WireDown(f"{self._place} gives no picture any more: is it unplugged?")
        grabbed_ns = time.monotonic_ns()
        captured_ns = grabbed_ns if not self.paced else self._device_ns(grabbed_ns)
        there, image = self._capture.retrieve()
        if not there or image is None:
            raise WireDown(f"{self._place} gives a picture that cannot be decoded")
        return Picture(self._cv2.cvtColor(image, self._cv2.COLOR_BGR2RGB), captured_ns)

    def _device_ns(self, grabbed_ns: int) -> int:
        """When V4L2 says that the picture was taken, if that is on our clock; else when we had it."""
        device_ns = round(self._capture.get(self._cv2.CAP_PROP_POS_MSEC) * _MS)
        age_ns = grabbed_ns - device_ns
        self._is_on_our_clock = self._is_on_our_clock or 0 <= age_ns <= TRUSTED_NS
        return device_ns if self._is_on_our_clock and age_ns >= 0 else grabbed_ns


async def open_camera(settings: CameraSettings) -> OpenCVSource:
    """Raise ``WireDown``."""
    import cv2

    return await _in_thread(lambda: open_with(settings, cv2))


def open_with(settings: CameraSettings, cv2: Any) -> OpenCVSource:
    """Open the device, and set it as the settings say. Raise ``WireDown``."""
    cv2.setNumThreads(1)  # its pool would take every processor for a picture
    place = settings.index_or_path
    capture = cv2.VideoCapture(place, settings.backend or _backend(place, cv2))
    try:
        if not capture.isOpened():
            raise WireDown(f"{place} cannot be opened. {_there_are()}")
        _set(capture, settings, cv2)
    except BaseException:
        capture.release()
        raise
    return OpenCVSource(capture, cv2, place)


def _set(capture: Any, settings: CameraSettings, cv2: Any) -> None:
    """The format first: sizes and rates depend on it. Raise ``Unfit`` for what is not taken."""
    if _is_file(settings.index_or_path):
        return
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest one, not four that wait
    if settings.fourcc is not None:
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter_fourcc(*settings.fourcc))
    width, height = settings.captured_size
    wanted = (
        ("width", cv2.CAP_PROP_FRAME_WIDTH, width),
        ("height", cv2.CAP_PROP_FRAME_HEIGHT, height),
        ("fps", cv2.CAP_PROP_FPS, settings.fps),
    )
    for _, what, value in wanted:
        if value is not None:
            capture.set(what, value)
    for word, what, value in wanted:
        has = capture.get(what)
        if value is not None and has > 0 and abs(has - value) > 1e-3 * value:
            raise Unfit(
                f"{settings.index_or_path} gives {word} {has:g}, and {value:g} is asked for. "
                "v4l2-ctl --list-formats-ext shows what it has; many need fourcc 'MJPG'"
            )


def _backend(place: int | str, cv2: Any) -> int:
    """Of a device, V4L2; of what is none, whatever reads it."""
    is_device = isinstance(place, int) or place.startswith("/dev/")
    backend: int = cv2.CAP_V4L2 if is_device and hasattr(cv2, "CAP_V4L2") else cv2.CAP_ANY
    return backend


def _is_file(place: int | str) -> bool:
    return isinstance(place, str) and os.path.isfile(place)


def _there_are() -> str:
    found = sorted(glob.glob("/dev/video*"))
    return f"there are {', '.join(found)}" if found else "there is no /dev/video* here"


async def _in_thread(call: Callable[[], T]) -> T:
    """Who waits for it has a deadline, and ends the process when that is over: a thread cannot be
    ended."""
    return await trio.to_thread.run_sync(call, abandon_on_cancel=True)
