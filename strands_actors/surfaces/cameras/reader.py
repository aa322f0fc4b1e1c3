"""Read the pictures of a camera, in the program that has the robot or in any other process of this user."""

from __future__ import annotations

import contextlib
import os
import threading
import time

from strands_actors.contract.axis import finite
from strands_actors.contract.plain_numbers import as_python
from strands_actors.kernel.channels.frame_ring import FrameRing, NoRing, Shot

from . import report as reports
from .frames import Frame, Stale
from .picture_files import cameras_of, ring_path
from .report import CameraReport

LOOK_S = 0.5
"""Period of the check if a file without new pictures was replaced."""


class CameraReader:
    """Read one camera of one robot. Reading never waits for the camera.

    The reader keeps working when the camera's process or the robot restarts. Any thread may use the reader.

    Args:
        path: The file of the pictures.
        robot: The name of the robot.
        camera: The name of the camera.
        bgr: Return pictures with the colours in the order blue, green, red.
    """

    def __init__(self, path: str, robot: str, camera: str, bgr: bool = False) -> None:
        self.robot = robot
        self.camera = camera
        self._path = path
        self._bgr = bgr
        self._lock = threading.Lock()
        self._ring: FrameRing | None = None
        self._looked_s = 0.0
        self._closed = False

    def newest(self, max_age_s: float | None = None) -> Frame | Stale:
        """Return the newest picture, or ``Stale`` if it is too old or missing.

        Args:
            max_age_s: Largest age in seconds. Default: three periods of the camera, and at least 0.2 s.

        Raises:
            ValueError: ``max_age_s`` is not a number above 0.
        """
        if max_age_s is not None and not (finite(as_python(max_age_s)) or 0.0) > 0.0:
            raise ValueError(f"newest: max_age_s is {max_age_s!r}. Give seconds, above 0")
        with self._lock:
            ring = self._open()
            if ring is None:
                return Stale(self._missing())
            stale_ns = ring.stale_ns if max_age_s is None else max_age_s * 1e9
            shot = ring.read()
            now_ns = time.monotonic_ns()
            if shot is None or now_ns - shot.captured_ns > stale_ns:
                ring = self._open(anew=True)
                shot = None if ring is None else ring.read()
                if ring is None or shot is None or now_ns - shot.captured_ns > stale_ns:
                    return self._stale(ring, shot, now_ns, stale_ns)
        return _frame(shot, self._bgr)

    def report(self) -> CameraReport:
        """Return the camera's report on its state."""
        with self._lock:
            ring = self._open()
            return CameraReport("down", self._missing()) if ring is None else reports.decode(ring.description)

    @property
    def sequence(self) -> int:
        """Return the number of the newest picture. 0 means that no camera runs."""
        with self._lock:
            ring = self._open()
            return 0 if ring is None else ring.newest

    @property
    def age_s(self) -> float | None:
        """Return the age of the newest picture in seconds, or None if there is no picture."""
        with self._lock:
            ring = self._open()
            captured_ns = 0 if ring is None else ring.captured_ns
        return (time.monotonic_ns() - captured_ns) / 1e9 if captured_ns else None

    def close(self) -> None:
        """Close the file. Later reads are ``Stale``. Further calls do nothing."""
        with self._lock:
            self._closed = True
            self._drop()

    def __enter__(self) -> CameraReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self, anew: bool = False) -> FrameRing | None:
        """Return the open file of pictures, or None if no camera runs. If ``anew`` is
        True, check first if a restarted camera has replaced the file."""
        if self._closed:
            return None
        now_s = time.monotonic()
        if self._ring is not None and not anew:
            return self._ring
        if now_s - self._looked_s < LOOK_S and self._looked_s:
            return self._ring
        self._looked_s = now_s
        if self._ring is not None and self._ring.is_current:
            return self._ring
        self._drop()
        with contextlib.suppress(NoRing):
            self._ring = FrameRing(self._path)
        return self._ring

    def _drop(self) -> None:
        if self._ring is not None:
            self._ring.close()
            self._ring = None

    def _missing(self) -> str:
        if self._closed:
            return "this reader was closed"
        return f"no camera {self.camera!r} of {self.robot} runs"

    def _stale(self, ring: FrameRing | None, shot: Shot | None, now_ns: int, stale_ns: float) -> Stale:
        if ring is None:
            return Stale(self._missing())
        report = reports.decode(ring.description)
        state = f"it is {report.state}{': ' if report.reason else ''}{report.reason}"
        if shot is None:
            return Stale(f"there is no picture yet. {state}")
        age_s = (now_ns - shot.captured_ns) / 1e9
        old = f"the newest picture is {age_s * 1e3:.0f} ms old, more than {stale_ns / 1e6:.0f}"
        return Stale(f"{old}. {state}", age_s, shot.number)


def attach_camera(robot: str, camera: str) -> CameraReader:
    """Return a reader for a camera of a robot that another process of this user runs.

    The pictures are RGB, even if the camera's ``color_mode`` is ``bgr``.

    Raises:
        ConnectionError: There is no such camera.
    """
    cameras = cameras_of(robot) if _is_name(robot) else []
    if camera not in cameras:
        listed = f"there are {', '.join(cameras)}" if cameras else f"no robot {robot!r} with cameras runs here"
        raise ConnectionError(f"attach_camera: {robot!r} has no camera {camera!r}. {listed}")
    return CameraReader(str(ring_path(robot, camera)), robot, camera)


def _is_name(robot: object) -> bool:
    return isinstance(robot, str) and robot != "" and os.sep not in robot and "*" not in robot


def _frame(shot: Shot, bgr: bool) -> Frame:
    import numpy

    image = numpy.frombuffer(shot.data, numpy.uint8).reshape(shot.height, shot.width, 3)
    return Frame(numpy.ascontiguousarray(image[:, :, ::-1]) if bgr else image, shot.captured_ns, shot.number)
