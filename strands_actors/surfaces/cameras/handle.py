"""The cameras of one robot, for the program that runs it."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from strands_actors.contract.axis import finite
from strands_actors.contract.cameras import CameraSettings
from strands_actors.contract.plain_numbers import as_python
from strands_actors.kernel.channels.frame_ring import create

from .config import MAX_SIDE, ROBOT, SCENE, source_of, stale_s
from .frames import Frame, Stale, StaleFrame
from .picture_files import remove, ring_path, sweep
from .reader import CameraReader

ENTRY = "strands_actors.surfaces.cameras.process:main"
COLOURS = 3
UNKNOWN = MAX_SIDE * MAX_SIDE * 3 // 4
"""Most pixels of a picture without a configured size. Memory is used only for pictures that come."""


class Cameras:
    """The cameras of one robot handle.

    The object is made with the handle. ``begin`` is called each time the robot's processes are started.

    Args:
        settings: The settings of each camera.
        driver_class: The robot's driver.
    """

    def __init__(self, settings: Sequence[CameraSettings], driver_class: type[Any]) -> None:
        self._settings = {each.name: each for each in settings}
        self._driver_class = driver_class
        self._robot = ""
        self._readers: dict[str, CameraReader] = {}

    def __bool__(self) -> bool:
        return bool(self._settings)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._settings)

    def begin(
        self, robot: str, robot_type: str, label: str, port: str, control: str, options: Mapping[str, Any]
    ) -> list[dict[str, Any]]:
        """Make a file of pictures for each camera, and return the descriptions by which the root process (which
        starts the robot's other processes) starts the camera processes.

        Args:
            robot: The name of the robot.
            robot_type: The kind of the robot.
            label: The robot's label in the operating system's list of processes.
            port: The robot's port or address.
            control: The control address of the simulation, for a camera of type ``scene``.
            options: The robot's options, for a camera of type ``robot``.

        Raises:
            OSError: A file cannot be made.
        """
        self.end()
        if not self._settings:
            return []
        sweep()
        self._robot = robot
        kept = []
        for name, settings in self._settings.items():
            path = str(ring_path(robot, name, make=True))
            pixels = UNKNOWN if settings.width is None else settings.width * (settings.height or 0)
            create(path, pixels * COLOURS, round(stale_s(settings) * 1e9))
            own: dict[str, Any] = {"robot": robot_type, "port": control if settings.type == SCENE else port}
            if settings.type == ROBOT:
                own["options"] = dict(options)
            args = {
                "robot": robot,
                "label": label,
                "ring": path,
                "source": source_of(settings, self._driver_class),
                "settings": msgspec.to_builtins(msgspec.structs.replace(settings, **own)),
            }
            kept.append({"name": name, "ring": path, "entry": ENTRY, "args": args})
            self._readers[name] = CameraReader(path, robot, name, bgr=settings.color_mode == "bgr")
        return kept

    def join(self, robot: str) -> None:
        """Read the pictures of cameras that another program of this user has started. The files are its own."""
        self.leave()
        self._readers = {
            name: CameraReader(str(ring_path(robot, name)), robot, name, bgr=settings.color_mode == "bgr")
            for name, settings in self._settings.items()
        }

    def leave(self) -> None:
        """Close the readers. Later reads return ``Stale``."""
        for reader in self._readers.values():
            reader.close()
        self._readers = {}

    def end(self) -> None:
        """Close the readers and remove the files, after the robot's processes have ended. Later reads return
        ``Stale``."""
        self.leave()
        if self._robot:
            with contextlib.suppress(OSError):
                remove(self._robot)
            self._robot = ""

    # -- reading

    def read(self, name: str, max_age_ms: float | None = None) -> Frame:
        """Return the newest picture of a camera.

        Args:
            name: The camera.
            max_age_ms: Largest age in milliseconds. Default: three periods of the camera, and at least
                200 ms.

        Raises:
            ValueError: There is no such camera, or the age is not a positive number.
            StaleFrame: There is no picture that is new enough.
        """
        result = self.look(name, max_age_ms)
        if isinstance(result, Stale):
            raise StaleFrame(name, result)
        return result

    def look(self, name: str, max_age_ms: float | None = None) -> Frame | Stale:
        """Return the newest picture like ``read``, but return ``Stale`` instead of raising ``StaleFrame``."""
        if not isinstance(name, str) or name not in self._settings:
            listed = (
                f"there are {', '.join(self._settings)}"
                if self._settings
                else "this robot was made without cameras"
            )
            raise ValueError(f"read_camera: there is no camera {name!r}. {listed}")
        if max_age_ms is not None and not (finite(as_python(max_age_ms)) or 0.0) > 0.0:
            raise ValueError(f"read_camera: max_age_ms is {max_age_ms!r}. Give milliseconds, above 0")
        reader = self._readers.get(name)
        if reader is None:
            return Stale("the robot is not connected")
        return reader.newest(None if max_age_ms is None else max_age_ms / 1e3)

    def looks(self) -> dict[str, Frame | Stale]:
        """Return the newest picture of each camera, or ``Stale``."""
        return {name: self.look(name) for name in self._settings}

    def status(self) -> dict[str, dict[str, Any]]:
        """Return ``get_status()["cameras"]``."""
        return {name: self._status(name) for name in self._settings}

    def _status(self, name: str) -> dict[str, Any]:
        reader = self._readers.get(name)
        if reader is None:
            return {"state": "down", "why": "the robot is not connected", "age_s": None, "stale": True}
        report, age_s = reader.report(), reader.age_s
        is_stale = age_s is None or age_s > stale_s(self._settings[name])
        return {
            "state": report.state,
            "why": report.reason or None,
            "age_s": None if age_s is None else round(age_s, 4),
            "stale": is_stale,
            "pictures": reader.sequence,
            "opened": report.opened,
            "fps": report.fps,
            "width": report.width or None,
            "height": report.height or None,
            "jpeg": report.compressed or None,
        }
