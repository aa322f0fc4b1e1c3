"""Cameras of type ``opencv``: a V4L2 device, or a file or stream that OpenCV reads.

Only the camera's process imports OpenCV. Calls of OpenCV run in a thread, since some wait for the device.
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
"""A device's time stamps are used after the first one that is no older than this. The device then uses
the host's clock, and an older picture has waited in a buffer."""
_MS = 1_000_000


class Unfit(WireDown):
    """The device does not accept the requested settings."""


class OpenCVSource:
    """A camera that is open.

    Args:
        capture: A ``cv2.VideoCapture`` that is open.
        cv2: OpenCV's Python module.
        place: The device's number or path, for messages.
    """

    def __init__(self, capture: Any, cv2: Any, place: int | str) -> None:
        self._capture = capture
        self._cv2 = cv2
        self._place = place
        self._is_on_our_clock = False
        self.paced = not _is_file(
            place
        )  # A device delivers pictures at its own rate. A file delivers them at once.

    async def read(self) -> Picture:
        return await _in_thread(self._read)

    async def aclose(self) -> None:
        await _in_thread(self._capture.release)

    def _read(self) -> Picture:
        if not self._capture.grab():
            raise WireDown(f"{self._place} gives no more pictures. Check that it is plugged in")
        grabbed_ns = time.monotonic_ns()
        captured_ns = grabbed_ns if not self.paced else self._device_ns(grabbed_ns)
        decoded, image = self._capture.retrieve()
        if not decoded or image is None:
            raise WireDown(f"a picture of {self._place} cannot be decoded")
        return Picture(self._cv2.cvtColor(image, self._cv2.COLOR_BGR2RGB), captured_ns)

    def _device_ns(self, grabbed_ns: int) -> int:
        """Return V4L2's time stamp of the picture if it is on the host's clock; otherwise the time at which
        the picture was grabbed."""
        device_ns = round(self._capture.get(self._cv2.CAP_PROP_POS_MSEC) * _MS)
        age_ns = grabbed_ns - device_ns
        self._is_on_our_clock = self._is_on_our_clock or 0 <= age_ns <= TRUSTED_NS
        return device_ns if self._is_on_our_clock and age_ns >= 0 else grabbed_ns


async def open_camera(settings: CameraSettings) -> OpenCVSource:
    """Open a camera in a thread. Raise ``WireDown`` if that fails."""
    import cv2

    return await _in_thread(lambda: open_with(settings, cv2))


def open_with(settings: CameraSettings, cv2: Any) -> OpenCVSource:
    """Open the device and apply the settings.

    Raises:
        WireDown: The device cannot be opened, or it does not accept the settings.
    """
    cv2.setNumThreads(1)  # OpenCV would otherwise use all processors for each picture.
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
    """Apply the settings, the pixel format first, since the possible sizes and rates depend on it. Raise
    ``Unfit`` for a setting that the device does not accept."""
    if _is_file(settings.index_or_path):
        return
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # OpenCV buffers four pictures by default, and three of them are old.
    if settings.fourcc is not None:
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter_fourcc(*settings.fourcc))
    width, height = settings.captured_size
    requested = (
        ("width", cv2.CAP_PROP_FRAME_WIDTH, width),
        ("height", cv2.CAP_PROP_FRAME_HEIGHT, height),
        ("fps", cv2.CAP_PROP_FPS, settings.fps),
    )
    for _, number, value in requested:
        if value is not None:
            capture.set(number, value)
    for word, number, value in requested:
        actual = capture.get(number)
        if value is not None and actual > 0 and abs(actual - value) > 1e-3 * value:
            raise Unfit(
                f"{settings.index_or_path} gives {word} {actual:g}, and {value:g} is asked for. "
                "v4l2-ctl --list-formats-ext shows what it has; many need fourcc 'MJPG'"
            )


def _backend(place: int | str, cv2: Any) -> int:
    """Return V4L2 for a device. For a file or stream let OpenCV choose."""
    is_device = isinstance(place, int) or place.startswith("/dev/")
    backend: int = cv2.CAP_V4L2 if is_device and hasattr(cv2, "CAP_V4L2") else cv2.CAP_ANY
    return backend


def _is_file(place: int | str) -> bool:
    return isinstance(place, str) and os.path.isfile(place)


def _there_are() -> str:
    devices = sorted(glob.glob("/dev/video*"))
    return f"there are {', '.join(devices)}" if devices else "there is no /dev/video* here"


async def _in_thread(call: Callable[[], T]) -> T:
    """Run a call of OpenCV in a thread. A thread that hangs cannot be ended. So the caller sets a timeout, and
    ends the process when the timeout expires."""
    return await trio.to_thread.run_sync(call, abandon_on_cancel=True)
